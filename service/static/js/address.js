// The page's URL and history: it names a scene, a job, or a scene beside a running job.

/** The query string of a scene and of a job, either of which may be null. */
export function addressOf(scene, job) {
  const named = new URLSearchParams();
  if (scene !== null) named.set("scene", scene);
  if (job !== null) named.set("job", job);
  return String(named) && `?${named}`;
}

export const named = (what) => new URLSearchParams(location.search).get(what);

/** Add a step to the history, or replace the last one. */
export const step = (address) => history.pushState(null, "", `/${address}`);
export const instead = (address) => history.replaceState(null, "", `/${address}`);

/** Put a new job into the URL: as a new step, or beside the scene if the user has left the address `since` meanwhile. */
export function nameJob(job, since) {
  if (location.search === since) step(addressOf(null, job));
  else instead(addressOf(named("scene"), job));
}

/** Remove a job that has ended from the URL, which then names the scene on `show`, or none if that is null. */
export function forgetJob(job, show) {
  if (named("job") === job) instead(addressOf(named("scene") ?? show, null));
}
