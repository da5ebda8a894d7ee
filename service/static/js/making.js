// A new scene: what the service understood of the files that are chosen, and their way to it as a job or as they are.

import { addressOf, forgetJob, nameJob } from "./address.js";
import { ask, askBlob, askJson, Refused } from "./api.js";
import { add, all, cameras, fillChooser, gaussians, images, isCameras, prepareChosen, strays, takeAllOut, takeOut, zips } from "./chosen.js";
import { $, counted, discard, make, tell } from "./dom.js";
import { prepareDropping } from "./dropping.js";
import { follow, following } from "./job.js";
import { fill, prepareOptions, tellSet, unset } from "./options.js";
import { impossible, missing, MOST, withName } from "./refusals.js";
import { shown } from "./stage.js";
import { understood } from "./understood.js";

const OF_PHOTOGRAPHS = ["near", "far", "detail", "trust_poses", "context"]; // options on which a check depends
const USUAL = "3"; // photographs that the service takes of a zip
const OF_GAUSSIANS = ["near", "far", "opacity", "scales", "rotation", "axes", "drop_invalid"];

let asked = new AbortController(); // of the newest check or loading: a late answer to an earlier one is passed over
let looking = null;    // the newest check or loading, with what it gives
let sent = null;       // of the photographs that are on their way
let refused = null;    // a file of Gaussians that was not loaded, and gives way to what comes next
let ready = false;     // what is chosen may be sent
let unchecked = false; // what is chosen got no answer
let running = false;   // a job is sent or followed
let held = false;      // the focus is on Cancel, or was when that was hidden
let opened = () => {}; // called with a scene's id and what becomes of the address; gives where the eye goes then

export function prepareMaking(open) {
  opened = open;
  $("files").addEventListener("change", () => take([...$("files").files]));
  $("files").addEventListener("click", () => { $("files").value = ""; }); // or a file that was edited could not be chosen again
  $("files").addEventListener("cancel", fillChooser);
  prepareDropping(take);
  $("clear").addEventListener("click", () => {
    clear();
    $("files").focus();
  });
  $("sample").addEventListener("click", sample);
  $("cancel").addEventListener("click", () => following() === null && (sent ?? asked).abort());
  $("cancel").addEventListener("focus", () => { held = true; });
  $("cancel").addEventListener("blur", () => { held = $("cancel").hidden; });
  $("upload").addEventListener("submit", (event) => {
    event.preventDefault();
    if (running) return;
    if (unchecked) checkOnceMore();
    else if (ready) (gaussians().length ? check : begin)();
  });
  $("upload").addEventListener("change", ({ target }) => {
    if (all().length && (gaussians().length ? OF_GAUSSIANS : OF_PHOTOGRAPHS).includes(target.id)) check(ready && !gaussians().length);
  });
  prepareChosen(() => (all().length ? others() : clear()));
  prepareOptions();
}

export async function prepareModels() {
  const { models, max_detail } = await askJson("/models");
  $("detail-row").hidden = max_detail < 2;
  $("detail").checked &&= max_detail > 1; // browsers remember what was ticked
  $("model").replaceChildren(...models.map((model) => make("option", { value: model.name }, `${model.name}: ${model.preset}, ${model.width} × ${model.height} px`)));
  $("model-row").hidden = models.length < 2;
  tellSet();
}

function state(next) {
  ({ ready = ready, unchecked = unchecked, running = running } = next);
  $("go").disabled = !(ready || unchecked) || running;
  $("go").textContent = gaussians().length ? "Load" : unchecked ? "Check again" : "Reconstruct";
  $("sample").disabled = running;
  $("clear").hidden = all().length === 0;
}

/** Files come in addition to those that are there; beside cameras alone a file of Gaussians that was refused stays. */
function take(files) {
  if (refused && !files.every(isCameras)) takeOut(refused);
  refused = null;
  add(files);
  return others();
}

/** Other files are chosen than before. */
function others() {
  askHowMany(images().length);
  return check();
}

/** Whether fewer are to be used: as many as the service takes of a zip, until another number is chosen. */
function askHowMany(of) {
  if (of <= MOST) $("context").value = ""; // also one that the browser has brought back
  else if ($("choice").hidden) $("context").value = USUAL;
  $("choice").hidden = of <= MOST;
  if (of > MOST) $("so-many").textContent = `${counted(of, "photograph")}, and a scene takes 2 to ${MOST}. Use`;
}

/** What is asked of the service until now is given up. */
function anew() {
  asked.abort();
  asked = new AbortController();
  progress(null);
  return asked.signal;
}

function clear() {
  anew();
  sent?.abort();
  refused = null;
  takeAllOut();
  unset();
  askHowMany(0);
  say();
  tell($("problem"), null);
  state({ ready: false, unchecked: false });
}

/** The form of POST /reconstruct for what is chosen; a zip beside photographs holds a model of cameras. */
function form() {
  const data = new FormData();
  for (const file of images()) data.append("images", file, file.name);
  for (const file of zips()) data.append(images().length ? "cameras" : "capture", file, file.name);
  for (const file of cameras()) data.append("cameras", file, file.name);
  fill(data, ["context", "near", "far", "max_error", "detail", "trust_poses", "refine_poses"]);
  if (!$("model-row").hidden) data.set("model", $("model").value);
  return data;
}

/** Ask what the service understands, `again` of files that it took; gives whether a reconstruction may begin. */
const check = (again = false) => (looking = look(again));

async function look(again) {
  const signal = anew();
  const fault = impossible();
  const wish = missing();
  tell($("problem"), fault);
  if (wish || !again) state({ ready: false, unchecked: false }); // else nothing moves below a pointer that goes on to press
  if (wish || !again) say();
  if (fault) return false;
  if (gaussians().length) return load(gaussians()[0], signal);
  if (wish || !again) say(wish ?? "Checking the cameras …");
  if (wish) return false;
  $("understood").setAttribute("aria-busy", "true");
  try {
    const found = await askJson("/check", { method: "POST", body: form(), signal });
    if (signal.aborted) return false;
    if (found.selection.of > MOST) askHowMany(found.selection.of);
    say(...understood(found));
    state({ ready: true });
    return true;
  } catch (error) {
    if (signal.aborted) return false;
    say();
    state({ ready: false, unchecked: error.status === 0 || error.status >= 429 });
    tell($("problem"), withName(error));
    return false;
  }
}

/** What the newest check or loading gives, once it has ended. */
async function looked() {
  const last = looking;
  const result = await last;
  return last === looking ? result : looked();
}

/** The button that was pressed cannot hold the focus meanwhile. */
async function checkOnceMore() {
  await check();
  if (document.activeElement === document.body) $("go").focus();
}

/** The service is there, or has its key: what it did not look at before is asked for again, once what is under way has failed. */
export async function checkAgain() {
  await looked();
  if (all().length && (refused || !ready) && !running) check();
}

/** What is understood, in words that screen readers hear, and in pictures. */
function say(words = "", ...nodes) {
  $("in-words").textContent = words;
  discard($("in-pictures"));
  $("in-pictures").append(...nodes);
  $("understood").removeAttribute("aria-busy");
}

/** What is on its way, which can be cancelled; null when nothing is. What is made has the place first. */
function progress(words) {
  if (busy()) return;
  for (const id of ["progress", "cancel"]) $(id).hidden = words === null;
  $("bar").removeAttribute("value");
  $("stages").replaceChildren();
  $("stage-name").textContent = words ?? "";
}

async function sample() {
  clear();
  const { signal } = asked;
  try {
    const names = ["images/001.png", "images/005.png", "cameras.json"];
    const files = await Promise.all(names.map(async (name) => {
      const blob = await askBlob(`/static/sample/${name}`, { signal });
      return new File([blob], name.split("/").pop(), { type: blob.type });
    }));
    if (!signal.aborted && (await take(files))) await send();
  } catch (error) {
    if (!signal.aborted) tell($("problem"), error);
  }
}

/** A file of Gaussians goes into the store as it is, with cameras where there are any; one that is refused stays. */
async function load(file, signal) {
  const here = location.search;
  const data = fill(new FormData(), OF_GAUSSIANS);
  data.append("file", file, file.name);
  for (const beside of [...cameras(), ...zips()]) data.append("cameras", beside, beside.name);
  progress(`Loading ${file.name} …`);
  try {
    const scene = await askJson("/scenes", { method: "POST", body: data, signal });
    if (signal !== asked.signal) return false;
    const wasHeld = held;
    clear();
    const place = await opened(scene.id, location.search === here ? "push" : "offer");
    if (wasHeld) passFocus(place);
  } catch (error) {
    if (signal !== asked.signal) return false;
    refused = file;
    if (!signal.aborted) tell($("problem"), curedByOption(error));
    state({ ready: true });
    progress(null);
    if (held) passFocus($("go"));
  }
  return false;
}

/** In the page's words where one of its options helps, which is shown then. */
function curedByOption(error) {
  if (!/drop_invalid/.test(error.problem?.cure)) return error;
  $("options").open = true;
  return { ...error.problem, cure: "tick \"Leave out rows that cannot be read\" under Options" };
}

/** Reconstruct what is chosen, once the newest check has ended well. */
async function begin() {
  if ((await looked()) && ready && !running) await send();
}

async function send() {
  const here = location.search;
  const headers = { Prefer: "respond-async" };
  let job = null;
  tell($("problem"), null);
  progress(`Sending ${counted(all().length - strays().length, "file")} …`);
  sent = new AbortController();
  if ([$("go"), $("sample")].includes(document.activeElement)) $("cancel").focus(); // they cannot be pressed then
  state({ running: true });
  try {
    const answer = await ask("/reconstruct", { method: "POST", body: form(), headers, signal: sent.signal });
    job = answer.headers.get("Location").split("/").pop();
  } catch (error) {
    if (!sent.signal.aborted) tell($("problem"), withName(error));
    ended();
  } finally {
    sent = null;
  }
  if (job === null) return;
  nameJob(job, here);
  await attend(job);
}

/** Nothing runs any more. */
function ended() {
  for (const id of ["progress", "cancel"]) $(id).hidden = true;
  state({ running: false });
  if (held) passFocus($(ready ? "go" : "files"));
}

/** Cancel had the focus, and is gone. */
function passFocus(target) {
  held = false;
  target.focus({ preventScroll: true });
}

/** Whether photographs are on their way or a job is followed: one at a time. */
export const busy = () => sent !== null || following() !== null;

/** Wait for a job and open its scene, or offer it beside another one that was chosen meanwhile. */
export async function attend(id) {
  state({ running: true });
  try {
    const scene = await follow(id);
    const wasHeld = held;
    const waits = location.search === addressOf(null, id);
    const place = await opened(scene, waits ? "replace" : "offer");
    if (!waits) forgetJob(id, shown());
    if (wasHeld) passFocus(place);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (error.status === 401) return; // the key is asked for, and the address followed again with it
    forgetJob(id, shown());
    tell($("problem"), error);
  } finally {
    ended();
  }
}
