// A job as it runs: its stages as they come, to the end, also behind a reload of the page or a broken line.

import { ask, askJson, checkedId, events, Refused } from "./api.js";
import { $, make, tell } from "./dom.js";

const RETRIES = 20;
const PAUSE_MS = 1500;
const PASSING = [0, 502, 503, 504]; // nobody answers, or a proxy whose service starts again

let current = null;

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
  $("stage-name").textContent = "waiting for its turn";
  try {
    const job = await watched(id);
    if (job.state === "done") return job.links.scene.split("/").pop();
    throw new Ended(job.problem);
  } finally {
    current = null;
    $("progress").hidden = true;
    $("cancel").hidden = true;
  }
}

/** The job once it is over. */
async function watched(id) {
  let last = "0";
  for (let tries = 0; tries < RETRIES; tries += 1) {
    try {
      for await (const { id: number, event, data } of events(`${pathOf(id)}/events?after=${last}`)) {
        last = number;
        tries = 0;
        if (event === "stage") stage(data);
      }
      const job = await askJson(pathOf(id));
      if (job.state === "done" || job.problem) return job;
    } catch (error) {
      if (error instanceof Refused && !PASSING.includes(error.status)) throw new Ended(error.problem, error.status);
      if (!(error instanceof Refused || error instanceof TypeError)) throw error; // a line that breaks is a TypeError
    }
    $("stage-name").textContent = "the line broke; asking again";
    await pause(PAUSE_MS);
  }
  throw new Refused({ title: "Unreachable", detail: "the service does not answer", cure: "reload the page: the job goes on" });
}

function stage({ stage: name, done, total, seconds }) {
  $("bar").max = total;
  $("bar").value = done;
  $("stage-name").textContent = total > 1 ? `${name}, ${done} of ${total}` : name;
  if (seconds) $("stages").append(make("li", {}, `${name} ${seconds.toFixed(2)} s`));
}

$("cancel").addEventListener("click", async () => {
  if (current === null) return;
  try {
    await ask(pathOf(current), { method: "DELETE" });
  } catch (error) {
    tell($("problem"), error);
  }
});
