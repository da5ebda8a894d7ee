// The page: the list of scenes, a server-drawn view that orbits by drag, and the upload form. No other host is asked.
"use strict";

const $ = (id) => document.getElementById(id);
const DEGREES_PER_PX = 0.15;      // a drag over a 600 px wide picture turns by 90 degrees
const SMALL = 128;                // px, longer side while dragging
const SETTLE_MS = 150;            // after the last movement the full picture is drawn
const LISTED = 50;                // scenes shown, newest first

let scenes = [];
let chosen = null;                // scene document of the one on show
let view = "0";
let angle = 0;                    // degrees of orbit
let busy = false;                 // one request in flight
let wanted = null;                // the newest picture asked for meanwhile
let settle = 0;

function element(tag, text, attributes = {}) {
  const node = document.createElement(tag);
  if (text !== undefined) node.textContent = text;
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

function showProblem(target, problem) {
  target.replaceChildren();
  if (!problem) return;
  const where = problem.field ? ` (${problem.field}${problem.index === undefined ? "" : " " + problem.index})` : "";
  target.append(element("strong", `${problem.title}${where}: `), problem.detail || "");
  if (problem.cure) target.append(element("br"), problem.cure);
}

async function problemOf(response) {
  try {
    return await response.json();
  } catch {
    return { title: "Error", detail: `the service answered ${response.status}` };
  }
}

const unreachable = { title: "Unreachable", detail: "the service does not answer" };

function renderUrl(small) {
  const channel = $("channel").value;
  const format = small && channel === "rgb" ? "jpeg" : "png";
  const query = new URLSearchParams({ scene: chosen.id, view, channel, format });
  if (small) {
    const fitted = chosen.view_cameras[0];
    query.set(fitted.width >= fitted.height ? "width" : "height", String(SMALL));
  }
  return `/render?${query}`;
}

async function draw(url) {
  if (busy) { wanted = url; return; }
  busy = true;
  try {
    const response = await fetch(url);
    if (response.ok) {
      const old = $("picture").src;
      $("picture").src = URL.createObjectURL(await response.blob());
      if (old.startsWith("blob:")) URL.revokeObjectURL(old);
      showProblem($("view-problem"), null);
    } else {
      showProblem($("view-problem"), await problemOf(response));
    }
  } catch {
    showProblem($("view-problem"), unreachable);
  }
  busy = false;
  if (wanted) { const next = wanted; wanted = null; draw(next); }
}

function look(small) {
  if (!chosen) return;
  const place = view.startsWith("orbit:") ? `orbit ${angle.toFixed(1)}°` : `${chosen.file ? "" : "input "}view ${view}`;
  $("caption").textContent = `${place}. Drag the picture, or use the arrow keys, to orbit.`;
  $("picture").alt = `Scene ${chosen.id}, ${place}`;
  draw(renderUrl(small));
}

function turn(degrees) {
  angle = ((angle + degrees + 540) % 360) - 180;
  view = `orbit:${angle.toFixed(2)}`;
  look(true);
  clearTimeout(settle);
  settle = setTimeout(() => look(false), SETTLE_MS);
}

async function choose(id) {
  const response = await fetch(`/scenes/${encodeURIComponent(id)}`);
  if (!response.ok) { showProblem($("view-problem"), await problemOf(response)); return; }
  chosen = await response.json();
  view = "0";
  angle = 0;
  $("controls").hidden = false;
  $("empty").hidden = true;
  $("files").replaceChildren("Download ", ...fileLinks(chosen.links.files));
  $("views").replaceChildren(...chosen.view_cameras.map((_, index) => {
    const button = element("button", `View ${index}`, { type: "button" });
    button.addEventListener("click", () => { view = String(index); angle = 0; look(false); });
    return button;
  }));
  listScenes();
  look(false);
}

function fileLinks(files) {
  return Object.entries(files).flatMap(([extension, href]) => [element("a", `.${extension}`, { href, download: "" }), " "]);
}

function listScenes() {
  $("scenes").replaceChildren(...scenes.slice(0, LISTED).map((scene) => {
    const item = element("li");
    if (chosen && chosen.id === scene.id) item.className = "chosen";
    const button = element("button", undefined, { type: "button", "aria-label": `Show scene ${scene.id}` });
    button.append(element("img", undefined, { src: `${scene.links.views[0]}&height=72&format=jpeg`, alt: "", loading: "lazy" }));
    button.addEventListener("click", () => choose(scene.id));
    const about = element("div");
    about.append(element("p", scene.id), element("p", `${scene.file ? `from a .${scene.file}` : `${scene.views} photographs`}, ${scene.gaussians} Gaussians, ${scene.created}`));
    const link = element("p");
    link.append(...fileLinks(scene.links.files));
    about.append(link);
    item.append(button, about);
    return item;
  }));
  if (scenes.length > LISTED) $("scenes").append(element("li", `and ${scenes.length - LISTED} older scenes`));
}

async function refresh() {
  try {
    const response = await fetch("/scenes");
    if (response.ok) scenes = (await response.json()).scenes;
  } catch {
    showProblem($("view-problem"), unreachable);
    return;
  }
  listScenes();
}

async function awaitReady() {
  for (;;) {
    try {
      const response = await fetch("/readyz");
      const body = await response.json();
      if (response.ok) { $("state").textContent = `Model ${body.model.preset}, ${body.model.width} × ${body.model.height} px.`; return; }
      $("state").textContent = body.detail;
      if (body.state === "failed") return;
    } catch {
      $("state").textContent = "The service does not answer.";
    }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

async function upload(event) {
  event.preventDefault();
  const data = new FormData($("upload"));
  for (const name of ["near", "far"]) if (!data.get(name)) data.delete(name);
  const button = $("upload").querySelector("button");
  const start = performance.now();
  const clock = setInterval(() => {
    $("progress").textContent = `Reconstructing, ${((performance.now() - start) / 1000).toFixed(1)} s`;
  }, 100);
  showProblem($("problem"), null);
  button.disabled = true;
  try {
    const request = fetch("/reconstruct", { method: "POST", body: data, headers: { Accept: "application/json" } });
    const response = await request.finally(() => clearInterval(clock));
    if (response.ok) {
      const scene = await response.json();
      const stages = Object.entries(scene.timings).map(([stage, seconds]) => `${stage} ${seconds.toFixed(2)} s`);
      $("progress").textContent = `${response.status === 200 ? "Already there" : "Done"}: ${stages.join(", ")}`;
      await refresh();
      await choose(scene.id);
    } else {
      $("progress").textContent = "";
      showProblem($("problem"), await problemOf(response));
    }
  } catch {
    $("progress").textContent = "";
    showProblem($("problem"), unreachable);
  }
  button.disabled = false;
}

async function load(event) {
  event.preventDefault();
  showProblem($("load-problem"), null);
  try {
    const response = await fetch("/scenes", { method: "POST", body: new FormData($("load")) });
    if (response.ok) {
      const scene = await response.json();
      $("loaded").textContent = scene.warnings.map((warning) => warning.message).join("; ");
      await refresh();
      await choose(scene.id);
    } else {
      showProblem($("load-problem"), await problemOf(response));
    }
  } catch {
    showProblem($("load-problem"), unreachable);
  }
}

async function remove() {
  if (!chosen || !confirm(`Delete scene ${chosen.id}?`)) return;
  const response = await fetch(`/scenes/${encodeURIComponent(chosen.id)}`, { method: "DELETE" });
  if (!response.ok) { showProblem($("view-problem"), await problemOf(response)); return; }
  chosen = null;
  $("picture").removeAttribute("src");
  $("controls").hidden = true;
  $("empty").hidden = false;
  $("caption").textContent = "";
  await refresh();
  if (scenes.length) choose(scenes[0].id);
}

$("stage").addEventListener("pointerdown", (event) => {
  $("stage").setPointerCapture(event.pointerId);
  $("stage").classList.add("dragging");
});
$("stage").addEventListener("pointermove", (event) => {
  if (event.buttons && chosen && event.movementX) turn(-event.movementX * DEGREES_PER_PX);
});
for (const name of ["pointerup", "pointercancel"]) {
  $("stage").addEventListener(name, () => $("stage").classList.remove("dragging"));
}
$("stage").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -3, ArrowRight: 3 }[event.key];
  if (step && chosen) { event.preventDefault(); turn(step); }
});
$("channel").addEventListener("change", () => look(false));
$("upload").addEventListener("submit", upload);
$("remove").addEventListener("click", remove);
$("load").addEventListener("submit", load);

(async () => {
  await awaitReady();
  await refresh();
  if (scenes.length) choose(scenes[0].id);
})();
