// A new scene: photographs and cameras that were dropped or chosen, what the service understood of them, and the job.

import { askBlob, askJson, Refused } from "./api.js";
import { $, counted, discard, make, tell } from "./dom.js";
import { Ended, follow } from "./job.js";
import { understood } from "./understood.js";

const GAUSSIANS = /\.(ply|splat|spz)$/i;
const ZIP = /\.zip$/i;
const CAMERAS = /\.(json|npy|txt)$/i;
const MOST = 6;       // photographs of a scene
const MOST_SENT = 60; // photographs that may be sent one by one

let chosen = [];       // files
let turn = 0;          // of checks: a late answer to an earlier one is passed over
let ready = false;     // what is chosen has passed its check
let running = false;   // a job is followed
let opened = () => {}; // called with a scene's id

export function prepareMaking(open) {
  opened = open;
  $("files").addEventListener("change", () => add([...$("files").files]));
  $("files").addEventListener("click", () => { $("files").value = ""; }); // or a file that was edited could not be chosen again
  $("files").addEventListener("cancel", showChosen);
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      $("drop").classList.add("over");
    });
  }
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && $("drop").classList.remove("over"));
  document.addEventListener("drop", dropped);
  $("clear").addEventListener("click", clear);
  $("sample").addEventListener("click", sample);
  $("upload").addEventListener("submit", (event) => {
    event.preventDefault();
    if (ready && !running) send();
  });
  for (const name of ["near", "far", "detail", "trust_poses", "context"]) $(name).addEventListener("change", () => chosen.length && check());
}

export async function prepareModels() {
  const { models, max_detail } = await askJson("/models");
  $("detail-row").hidden = max_detail < 2;
  $("detail").checked &&= max_detail > 1; // browsers remember what was ticked
  $("model").replaceChildren(...models.map((model) => make("option", { value: model.name }, `${model.name}: ${model.preset}, ${model.width} × ${model.height} px`)));
  $("model-row").hidden = models.length < 2;
}

function state(next) {
  ({ ready = ready, running = running } = next);
  $("go").disabled = !ready || running;
  $("sample").disabled = running;
  $("clear").hidden = chosen.length === 0;
}

function dropped(event) {
  event.preventDefault();
  $("drop").classList.remove("over");
  const folder = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry?.()).find((entry) => entry?.isDirectory);
  if (!folder) return void add([...event.dataTransfer.files]);
  tell($("problem"), { title: "A folder", detail: `${folder.name} is a folder`, cure: "drop its photographs with the camera file, or one zip of it" });
}

/** Files in addition to those that are there; one of the same name takes its place. */
function add(files) {
  const names = new Set(files.map((file) => file.name));
  chosen = [...chosen.filter((file) => !names.has(file.name)), ...files];
  showChosen();
  return check();
}

/** In the chooser, which tells the number or the name; and whether fewer are to be used. */
function showChosen() {
  const holder = new DataTransfer();
  for (const file of chosen) holder.items.add(file);
  $("files").files = holder.files;
  const several = images().length > MOST;
  $("choice").hidden = !several;
  if (several) $("so-many").textContent = `${counted(images().length, "photograph")}, and a scene takes 2 to ${MOST}. Use`;
  else $("context").value = "";
}

function clear() {
  turn += 1;
  chosen = [];
  showChosen();
  discard($("understood"));
  tell($("problem"), null);
  state({ ready: false });
}

const named = (pattern) => chosen.filter(({ name }) => pattern.test(name));
const images = () => chosen.filter(({ name }) => ![GAUSSIANS, ZIP, CAMERAS].some((pattern) => pattern.test(name)));

/** Fields that are filled in go into a form. */
function fill(data, names) {
  for (const name of names) if ($(name).value.trim()) data.set(name, $(name).value.trim());
  return data;
}

/** The form of POST /reconstruct for what is chosen; a zip beside photographs holds a model of cameras. */
function form() {
  const data = new FormData();
  for (const file of images()) data.append("images", file, file.name);
  for (const file of named(ZIP)) data.append(images().length ? "cameras" : "capture", file, file.name);
  for (const file of named(CAMERAS)) data.append("cameras", file, file.name);
  fill(data, ["context", "near", "far", "max_error"]);
  if ($("detail").checked) data.set("detail", "2");
  if ($("trust_poses").checked) data.set("trust_poses", "true");
  if (!$("model-row").hidden) data.set("model", $("model").value);
  return data;
}

/** What is still missing, as a sentence; null where all is there. */
function missing() {
  const count = images().length;
  if (named(ZIP).length && !count) return null;
  if (!named(CAMERAS).length && !named(ZIP).length) {
    return `${counted(count, "photograph")}. Add their camera file: cameras.json, transforms.json, poses_bounds.npy or a RealEstate10K .txt, or a zip of a COLMAP model.`;
  }
  if (count > MOST && !$("context").value) return `${counted(chosen.length, "file")}. Say how many photographs are to be used.`;
  return count < 2 ? `${count} of 2 to ${MOST} photographs.` : null;
}

/** What this page itself refuses. */
function impossible() {
  const count = images().length;
  if (named(GAUSSIANS).length && count) {
    return { title: "Two kinds of files", detail: `${counted(count, "photograph")} beside ${named(GAUSSIANS)[0].name}, which is a scene already`, cure: "start over with one kind of them" };
  }
  const cameras = [...named(CAMERAS), ...named(ZIP)];
  if (count && cameras.length > 1) {
    const names = cameras.slice(0, 4).map(({ name }) => name).join(", ");
    return { title: "Camera files", detail: `${cameras.length} beside the photographs, need one: ${names}`, cure: "start over with one of them; a COLMAP model of several files goes in as one zip" };
  }
  if (count <= MOST_SENT) return null;
  return { title: "View count", detail: `${count} photographs, one by one at most ${MOST_SENT}`, cure: "send them as one zip with their camera file: the best few are chosen" };
}

/** Ask what the service understands; gives whether a reconstruction may begin. */
async function check() {
  const mine = (turn += 1);
  state({ ready: false });
  tell($("problem"), impossible());
  if (impossible()) return false;
  if (named(GAUSSIANS).length) return load(named(GAUSSIANS)[0]);
  const wish = missing();
  say(make("p", {}, wish ?? "Looking at the cameras …"));
  if (wish) return false;
  try {
    const found = await askJson("/check", { method: "POST", body: form() });
    if (mine !== turn) return false;
    say(...understood(found));
    state({ ready: true });
    return true;
  } catch (error) {
    if (mine !== turn) return false;
    const names = chosen.slice(0, 8).map(({ name }) => name).join(", ");
    say(make("p", {}, `${counted(chosen.length, "file")}: ${names}${chosen.length > 8 ? ", …" : ""}`));
    tell($("problem"), error);
    return false;
  }
}

function say(...nodes) {
  discard($("understood"));
  $("understood").append(...nodes);
}

async function sample() {
  clear();
  try {
    const names = ["images/001.png", "images/005.png", "cameras.json"];
    const files = await Promise.all(names.map(async (name) => {
      const blob = await askBlob(`/static/sample/${name}`);
      return new File([blob], name.split("/").pop(), { type: blob.type });
    }));
    if (!chosen.length && (await add(files))) await send();
  } catch (error) {
    tell($("problem"), error);
  }
}

/** A file of Gaussians goes into the store as it is, with cameras where there are any. */
async function load(file) {
  const mine = turn;
  say(make("p", {}, `Loading ${file.name} …`));
  const data = fill(new FormData(), ["near", "far", "opacity", "scales", "rotation"]);
  data.append("file", file, file.name);
  for (const cameras of [...named(CAMERAS), ...named(ZIP)]) data.append("cameras", cameras, cameras.name);
  try {
    const scene = await askJson("/scenes", { method: "POST", body: data });
    if (mine !== turn) return false;
    clear();
    await opened(scene.id);
  } catch (error) {
    if (mine !== turn) return false;
    chosen = chosen.filter((one) => one !== file);
    showChosen();
    discard($("understood"));
    tell($("problem"), error);
    state({});
  }
  return false;
}

async function send() {
  tell($("problem"), null);
  state({ running: true });
  try {
    const job = await askJson("/reconstruct", { method: "POST", body: form(), headers: { Prefer: "respond-async" } });
    history.pushState(null, "", `/?job=${job.id}`);
    await attend(job.id);
  } catch (error) {
    tell($("problem"), error);
  } finally {
    state({ running: false });
  }
}

/** Wait for a job and open its scene; the address names the job until it has ended. */
export async function attend(id) {
  state({ running: true });
  try {
    await opened(await follow(id));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (error instanceof Ended && location.search === `?job=${id}`) history.replaceState(null, "", "/");
    tell($("problem"), error);
  } finally {
    state({ running: false });
  }
}
