// What the page's address names: a scene, a job, or a scene beside a job that runs.

/** The address of a scene and of a job, either of which may be null. */
export function addressOf(scene, job) {
  const named = new URLSearchParams();
  if (scene !== null) named.set("scene", scene);
  if (job !== null) named.set("job", job);
  return String(named) && `?${named}`;
}

export const named = (what) => new URLSearchParams(location.search).get(what);

/** A step to come back from, or the last one anew. */
export const step = (address) => history.pushState(null, "", `/${address}`);
export const instead = (address) => history.replaceState(null, "", `/${address}`);

/** A job begins: a step of its own, unless the user went on to another scene than that at the address `since`. */
export function nameJob(job, since) {
  if (location.search === since) step(addressOf(null, job));
  else instead(addressOf(named("scene"), job));
}

/** A job is over: the address goes on without it. */
export function forgetJob(job) {
  if (named("job") === job) instead(addressOf(named("scene"), null));
}
