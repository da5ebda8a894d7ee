// A job as it runs: its stages as they come, to the end, also behind a reload of the page or a broken line.

import { ask, askJson, checkedId, events, Refused } from "./api.js";
import { $, make, tell } from "./dom.js";

const RETRIES = 20;
const PAUSE_MS = 1500;
const PASSING = [0, 502, 503, 504]; // nobody answers, or a proxy whose service starts again

let current = null;
let ending = false; // it was asked to

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

const pathOf = (id) => `/jobs/${encodeURIComponent(id)}`;

/** The job that is followed, one at a time; null when none is. */
export const following = () => current;

/** The job ended without a scene, or is unknown: there is nothing to come back to. */
export class Ended extends Refused {}

/** Follow a job; gives the id of its scene, throws `Ended` with why there is none, `Refused` where nobody answers. */
export async function follow(id) {
  current = checkedId(id, "Job");
  $("progress").hidden = false;
  $("cancel").hidden = false;
  $("stages").replaceChildren();
  $("bar").removeAttribute("value");
  end(false);
  say("waiting for its turn");
  try {
    const job = await watched(id);
    if (job.state === "done") return job.links.scene.split("/").pop();
    throw new Ended(job.problem);
  } finally {
    current = null;
    $("progress").hidden = true;
    $("cancel").hidden = true;
    $("cancel").removeAttribute("aria-disabled");
  }
}

/** The job once it is over: by its events or, where none come, by asking for it every now and then. */
async function watched(id) {
  let last = "0";
  let refused = null;
  for (let tries = 0; tries < RETRIES; tries += 1) {
    await passing(async () => {
      for await (const { id: number, event, data } of events(`${pathOf(id)}/events?after=${last}`)) {
        last = number;
        if (event === "stage") stage(data);
      }
    });
    let job = null;
    refused = await passing(async () => { job = await askJson(pathOf(id)); });
    if (job?.state === "done" || job?.problem) return job;
    if (job) tries = 0;
    if (job?.stage) stage(job.stage);
    if (refused) say(`${refused.message}; asking again`);
    await pause(PAUSE_MS);
  }
  throw refused;
}

/** Do something; gives the refusal where it may pass, null where there was none. */
async function passing(act) {
  try {
    await act();
  } catch (error) {
    if (error instanceof TypeError) return new Refused({ title: "Unreachable", detail: "the line broke" }); // within a stream
    if (!(error instanceof Refused)) throw error;
    if (!PASSING.includes(error.status)) throw new Ended(error.problem, error.status);
    return new Refused({ ...error.problem, cure: "reload the page: the job goes on" }, error.status);
  }
  return null;
}

function stage({ stage: name, done, total, seconds }) {
  $("bar").max = total;
  $("bar").value = done;
  say(total > 1 ? `${name}, ${done} of ${total}` : name);
  if (!seconds) return;
  const line = make("li", { "data-stage": name }, `${name} ${seconds.toFixed(2)} s`);
  const told = [...$("stages").children].find((one) => one.dataset.stage === name); // a job may begin anew
  if (told) told.replaceWith(line);
  else $("stages").append(line);
}

/** What the job does now; that it is to end stays. */
function say(text) {
  $("stage-name").textContent = ending ? "ending after this stage" : text;
}

function end(now) {
  ending = now;
  $("cancel").setAttribute("aria-disabled", ending); // it keeps the focus, which goes on from it
}

$("cancel").addEventListener("click", async () => {
  if (current === null || ending) return;
  end(true);
  say("");
  try {
    await ask(pathOf(current), { method: "DELETE" });
  } catch (error) {
    end(false);
    tell($("problem"), error);
  }
});
