// A new scene: photographs and cameras that were dropped or chosen, what the service understood of them, and the job.

import { ask, askJson, Refused } from "./api.js";
import { $, digits, make, tell } from "./dom.js";
import { follow } from "./job.js";
import { colourOf, plan } from "./plan.js";

const GAUSSIANS = /\.(ply|splat|spz)$/i;
const CAPTURE = /\.zip$/i;
const CAMERAS = /\.(json|npy|txt)$/i;
const MOST = 6;

let chosen = [];       // files
let checking = null;   // aborts the check of files that are no longer chosen
let opened = () => {}; // called with a scene's id

export function prepareMaking(open) {
  opened = open;
  $("files").addEventListener("change", () => add([...$("files").files]));
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      $("drop").classList.add("over");
    });
  }
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && $("drop").classList.remove("over"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    $("drop").classList.remove("over");
    add([...event.dataTransfer.files]);
  });
  $("clear").addEventListener("click", clear);
  $("sample").addEventListener("click", sample);
  $("upload").addEventListener("submit", send);
  for (const name of ["near", "far", "trust_poses"]) $(name).addEventListener("change", () => chosen.length && check());
}

export async function prepareModels() {
  const { models } = await askJson("/models");
  $("model").replaceChildren(...models.map((model) => make("option", { value: model.name }, `${model.name}: ${model.preset}, ${model.width} × ${model.height} px`)));
  $("model-row").hidden = models.length < 2;
}

/** Files in addition to those that are there; one of the same name takes its place. */
function add(files) {
  $("files").value = "";
  const names = new Set(files.map((file) => file.name));
  chosen = [...chosen.filter((file) => !names.has(file.name)), ...files];
  check();
}

function clear() {
  checking?.abort();
  chosen = [];
  $("understood").replaceChildren();
  $("go").disabled = true;
  $("clear").hidden = true;
  tell($("problem"), null);
}

const images = () => chosen.filter((file) => ![GAUSSIANS, CAPTURE, CAMERAS].some((kind) => kind.test(file.name)));

/** The form of POST /reconstruct for what is chosen. */
function form() {
  const data = new FormData();
  for (const file of images()) data.append("images", file, file.name);
  for (const file of chosen.filter(({ name }) => CAPTURE.test(name))) data.append("capture", file, file.name);
  for (const file of chosen.filter(({ name }) => CAMERAS.test(name))) data.append("cameras", file, file.name);
  const context = $("context")?.value;
  if (context) data.set("context", context);
  for (const name of ["near", "far", "max_error"]) if ($(name).value.trim()) data.set(name, $(name).value.trim());
  if ($("trust_poses").checked) data.set("trust_poses", "true");
  if (!$("model-row").hidden) data.set("model", $("model").value);
  return data;
}

/** What is still missing, as a sentence; null where all is there. */
function missing() {
  if (chosen.some(({ name }) => CAPTURE.test(name))) return null;
  const photographs = images().length;
  if (!chosen.some(({ name }) => CAMERAS.test(name))) return `${photographs} photographs. Add their camera file: cameras.json, transforms.json, poses_bounds.npy or a RealEstate10K .txt, or a zip of a COLMAP model.`;
  if (photographs < 2) return `${photographs} of 2 to ${MOST} photographs.`;
  return null;
}

async function check() {
  checking?.abort();
  tell($("problem"), null);
  $("go").disabled = true;
  $("clear").hidden = chosen.length === 0;
  const gaussians = chosen.find(({ name }) => GAUSSIANS.test(name));
  if (gaussians) return load(gaussians);
  const wish = missing();
  const context = $("context")?.value;
  $("understood").replaceChildren(make("p", {}, wish ?? "Looking at the cameras …"));
  if (images().length > MOST) $("understood").append(choice(context));
  if (wish) return undefined;
  checking = new AbortController();
  try {
    show(await askJson("/check", { method: "POST", body: form(), signal: checking.signal }));
    $("go").disabled = false;
  } catch (error) {
    if (error.name === "AbortError") return undefined;
    $("understood").replaceChildren(make("p", {}, `${chosen.length} files: ${chosen.slice(0, 8).map(({ name }) => name).join(", ")}${chosen.length > 8 ? ", …" : ""}`));
    if (images().length > MOST) $("understood").append(choice(context));
    refused(error);
  }
  return undefined;
}

/** More photographs than a scene takes: how many of them may be chosen for the user. */
function choice(context) {
  const select = make("select", { id: "context" }, make("option", { value: "" }, "none: I take some away"),
    ...[2, 3, 4, 5, 6].map((number) => make("option", { value: String(number) }, `the best ${number}`)));
  select.value = context ?? "";
  select.addEventListener("change", check);
  return make("p", {}, make("label", {}, `${images().length} photographs, and a scene takes 2 to ${MOST}. Use `, select));
}

function show({ images: found, near, far, depth_range_source: source, paired_by: by, warnings, selection }) {
  const cards = found.map((image, index) => {
    const { fx, width, height } = image.camera;
    const angle = (2 * Math.atan((0.5 * width) / fx) * 180) / Math.PI;
    const picture = make("img", { alt: "" });
    picture.addEventListener("load", () => URL.revokeObjectURL(picture.src), { once: true });
    picture.src = thumbnail(image.thumbnail);
    const number = make("svg:svg", { viewBox: "0 0 12 12", width: 12, height: 12, "aria-hidden": "true" });
    number.append(make("svg:circle", { cx: 6, cy: 6, r: 6, fill: colourOf(index) }));
    return make("li", {}, picture, make("p", {}, number, ` ${index}: ${image.name}`), make("p", { class: "small" }, `${width} × ${height} px, ${angle.toFixed(0)}° wide`));
  });
  const several = $("context")?.closest("p");
  $("understood").replaceChildren(
    ...(several ? [several] : []),
    make("ul", { class: "cards" }, ...cards),
    plan(found.map((image) => image.camera), near, far),
    make("p", {}, `Cameras paired by ${by}. Depth from ${digits(near)} to ${digits(far)} (${source}), in the cameras' units.`),
    ...(selection.by === "score" ? [make("p", {}, `${found.length} of ${selection.of} photographs, chosen for their overlap and baselines.`)] : []),
    ...warnings.map((warning) => make("p", { class: "warning" }, make("strong", {}, "Note: "), warning.message)),
  );
}

function thumbnail(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  return URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" }));
}

function refused(error) {
  if (!(error instanceof Refused)) throw error;
  tell($("problem"), error.problem);
}

async function sample() {
  clear();
  try {
    const names = ["images/001.png", "images/005.png", "cameras.json"];
    add(await Promise.all(names.map(async (name) => {
      const blob = await (await ask(`/static/sample/${name}`)).blob();
      return new File([blob], name.split("/").pop(), { type: blob.type });
    })));
    await until(() => !$("go").disabled || $("problem").textContent !== "");
    if (!$("go").disabled) $("upload").requestSubmit();
  } catch (error) {
    refused(error);
  }
}

async function until(true_) {
  while (!true_()) await new Promise((resolve) => setTimeout(resolve, 50));
}

/** A file of Gaussians goes into the store as it is. */
async function load(file) {
  $("understood").replaceChildren(make("p", {}, `Loading ${file.name} …`));
  const data = new FormData();
  data.append("file", file, file.name);
  try {
    const scene = await askJson("/scenes", { method: "POST", body: data });
    clear();
    await opened(scene.id);
  } catch (error) {
    refused(error);
  }
}

async function send(event) {
  event.preventDefault();
  tell($("problem"), null);
  $("go").disabled = true;
  try {
    const job = await askJson("/reconstruct", { method: "POST", body: form(), headers: { Prefer: "respond-async" } });
    history.replaceState(null, "", `/?job=${job.id}`);
    await attend(job.id);
  } catch (error) {
    refused(error);
  } finally {
    $("go").disabled = chosen.length === 0;
  }
}

/** Wait for a job and open its scene. */
export async function attend(id) {
  try {
    await opened(await follow(id));
  } catch (error) {
    history.replaceState(null, "", "/");
    refused(error);
  }
}
