// A job as it runs: its stages as they come, to the end, also behind a reload of the page or a broken line.

import { ask, askJson, events, Refused } from "./api.js";
import { $, make } from "./dom.js";

const RETRIES = 20;
const PAUSE_MS = 1500;

let current = null;

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Follow a job; gives the id of its scene, or throws `Refused` with the job's problem. */
export async function follow(id) {
  current = id;
  $("progress").hidden = false;
  $("cancel").hidden = false;
  $("stages").replaceChildren();
  $("bar").removeAttribute("value");
  $("stage-name").textContent = "waiting for its turn";
  let last = "0";
  try {
    for (let tries = 0; tries < RETRIES; tries += 1) {
      try {
        for await (const { id: number, event, data } of events(`/jobs/${id}/events?after=${last}`)) {
          last = number;
          tries = 0;
          if (event === "stage") stage(data);
        }
        const job = await askJson(`/jobs/${id}`);
        if (job.state === "done") return job.links.scene.split("/").pop();
        if (job.problem) throw new Refused(job.problem, job.problem.status);
      } catch (error) {
        if (!(error instanceof Refused) || (error.status !== 0 && error.status !== 503)) {
          if (error instanceof Refused) throw error;
        }
      }
      $("stage-name").textContent = "the line broke; asking again";
      await pause(PAUSE_MS);
    }
    throw new Refused({ title: "Unreachable", detail: "the service does not answer", cure: "reload the page: the job goes on" });
  } finally {
    current = null;
    $("progress").hidden = true;
    $("cancel").hidden = true;
  }
}

function stage({ stage: name, done, total, seconds }) {
  $("bar").max = total;
  $("bar").value = done;
  $("stage-name").textContent = total > 1 ? `${name}, ${done} of ${total}` : name;
  if (seconds) $("stages").append(make("li", {}, `${name} ${seconds.toFixed(2)} s`));
}

$("cancel").addEventListener("click", () => current && ask(`/jobs/${current}`, { method: "DELETE" }));
