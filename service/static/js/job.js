// Following a job to its end by server-sent events, also after a reload or a broken connection.

import { ask, askJson, checkedId, events, Refused } from "./api.js";
import { $, counted, make, tell } from "./dom.js";

const PAUSE_MS = 1500;
const LONGEST = 8; // such pauses at most between two tries, which grow while nobody answers
const QUEUE_MS = 3000; // between questions how many scenes are before the one that waits, of which no event tells
const PASSING = [0, 502, 503, 504]; // transient: no answer, or a proxy whose service is restarting

let current = null;
let waits = false; // it is in the queue, as far as is known
let ending = false; // it was asked to
let complaint = null; // the node that tells that it could not be cancelled

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

const pathOf = (id) => `/jobs/${encodeURIComponent(id)}`;

/** The id of the job that is followed, null if none is. */
export const following = () => current;

/** Follow a job, also while nobody answers; returns the id of its scene. Throws `Refused` if there is none: it failed, is unknown, or its id is malformed. */
export async function follow(id) {
  current = checkedId(id, "Job");
  $("progress").hidden = false;
  $("cancel").hidden = false;
  $("stages").replaceChildren();
  $("bar").removeAttribute("value");
  end(false);
  queued();
  const asking = setInterval(() => waits && askPlace(id), QUEUE_MS);
  try {
    const job = await watched(id);
    if (job.state === "done") return job.links.scene.split("/").pop();
    throw new Refused(job.problem);
  } finally {
    clearInterval(asking);
    current = null;
    $("progress").hidden = true;
    $("cancel").hidden = true;
    $("cancel").removeAttribute("aria-disabled");
  }
}

/** The job once it has ended: by its events or, without them, by polling. */
async function watched(id) {
  let last = "0";
  for (let tries = 1; ; tries += 1) {
    let job = null;
    let heard = false;
    const refused = await passing(async () => { job = await askJson(pathOf(id)); });
    if (job?.state === "done" || job?.problem) return job;
    if (refused) say(`${refused.message}; retrying`);
    else {
      tries = 0;
      here(job);
      await passing(async () => {
        for await (const { id: number, event, data } of events(`${pathOf(id)}/events?after=${last}`)) {
          [last, heard] = [number, true];
          if (event === "stage") stage(data);
          else waits = data.state === "queued"; // for the first time, or again
        }
      });
    }
    if (!heard) await pause(PAUSE_MS * Math.min(Math.max(tries, 1), LONGEST));
  }
}

/** The service tells where the job is. */
function here(job) {
  if (complaint?.isConnected) tell($("problem"), null);
  if (job.stage) stage(job.stage);
  else queued(job.ahead);
}

/** It waits, and `ahead` others before it, where that is known. */
function queued(ahead) {
  waits = true;
  $("bar").removeAttribute("value");
  say(ahead ? `waiting in the queue, ${counted(ahead, "scene")} before yours` : "waiting in the queue");
}

/** Ask how many are before it now; without an answer what was said stays. */
async function askPlace(id) {
  const job = await askJson(pathOf(id)).catch(() => null);
  if (waits && id === current && job?.state === "queued") queued(job.ahead);
}

/** Run `act`; returns a transient error, null without one. Throws other refusals. */
async function passing(act) {
  try {
    await act();
  } catch (error) {
    if (error instanceof TypeError) return new Refused({ title: "Unreachable", detail: "the connection was lost" }); // broken within a stream
    if (!(error instanceof Refused)) throw error;
    if (!PASSING.includes(error.status)) throw error;
    return error;
  }
  return null;
}

function stage({ stage: name, done, total, seconds }) {
  waits = false;
  $("bar").max = total;
  $("bar").value = done;
  say(total > 1 ? `${name}, ${done} of ${total}` : name);
  if (!seconds) return;
  const line = make("li", { "data-stage": name }, `${name} ${seconds.toFixed(2)} s`);
  const told = [...$("stages").children].find((one) => one.dataset.stage === name); // a job may start again
  if (told) told.replaceWith(line);
  else $("stages").append(line);
}

/** Show what the job does, unless it is being cancelled. */
function say(text) {
  const said = ending ? "cancelling after this stage" : text;
  if ($("stage-name").textContent !== said) $("stage-name").textContent = said; // or screen readers say it again
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
    complaint = $("problem").firstChild;
  }
});
