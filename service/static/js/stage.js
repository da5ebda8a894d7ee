// The large view: drawn by the service while it is dragged, or by WebGL in a frame where both are there.

import { ask, Refused, showPicture } from "./api.js";
import { $, button, tell } from "./dom.js";
import { Orbit } from "./orbit.js";

const DEGREES_PER_PX = 0.3; // a drag over 300 px turns by a quarter
const SMALL = 128;          // px, longer side while it moves
const SETTLE_MS = 150;      // after the last movement the full picture is drawn
const PATIENCE_MS = 30000;  // for the first picture of the frame

let scene = null;
let orbit = null;
let busy = false;   // one request in flight
let wanted = null;  // the newest picture that was asked for meanwhile
let settle = 0;
let webgl = false;  // whether the frame can draw
let mode = "server";
let frameWait = 0;

/** Whether this browser has WebGL 2, and whether a processor would have to play the graphics card. */
function graphics() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return { there: false, slow: true };
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return { there: true, slow: /swiftshader|llvmpipe|software|basic render/i.test(name) };
}

/** Find out who can draw; WebGL draws from the start where a graphics card does it. */
export async function prepareStage() {
  const { there, slow } = graphics();
  let reason = there ? "" : "this browser has no WebGL 2";
  if (there) {
    try {
      await ask("/viewer");
    } catch (error) {
      reason = error.status === 404 ? "the service was built without the WebGL viewer" : error.problem.detail;
    }
  }
  webgl = reason === "";
  $("mode-webgl").disabled = !webgl;
  $("mode-webgl").title = webgl ? "" : `Not here: ${reason}`;
  setMode(webgl && !slow ? "webgl" : "server");
}

function setMode(next) {
  mode = next;
  for (const name of ["webgl", "server"]) $(`mode-${name}`).setAttribute("aria-pressed", String(name === mode));
  $("channel").disabled = mode === "webgl";
  showFrame();
  look(false);
}

function showFrame() {
  clearTimeout(frameWait);
  const frame = $("frame");
  const address = scene && mode === "webgl" ? `/viewer?scene=${encodeURIComponent(scene.id)}` : "about:blank";
  if (frame.dataset.address !== address) {
    frame.dataset.address = address;
    frame.dataset.drawn = "";
    frame.src = address;
  }
  frame.hidden = address === "about:blank" || frame.dataset.drawn === "";
  if (address !== "about:blank" && frame.dataset.drawn === "") frameWait = setTimeout(() => giveUp("it drew nothing in time"), PATIENCE_MS);
}

function giveUp(reason) {
  if (mode !== "webgl") return;
  setMode("server");
  tell($("view-problem"), { title: "WebGL viewer", detail: reason, cure: "the service draws instead" });
}

window.addEventListener("message", (event) => {
  if (event.origin !== location.origin || event.source !== $("frame").contentWindow) return;
  if (event.data.viewer === "drawn" && mode === "webgl") {
    clearTimeout(frameWait);
    $("frame").dataset.drawn = "yes";
    $("frame").hidden = false;
  } else if (event.data.viewer === "failed") {
    giveUp(event.data.reason);
  }
});

function pictureOf(small) {
  const channel = $("channel").value;
  const query = new URLSearchParams({ scene: scene.id, channel, format: small && channel === "rgb" ? "jpeg" : "png" });
  const camera = scene.view_cameras[orbit.view];
  if (orbit.moved) query.set("camera", JSON.stringify(orbit.camera()));
  else query.set("view", String(orbit.view));
  if (small) query.set(camera.width >= camera.height ? "width" : "height", String(SMALL));
  return `/render?${query}`;
}

async function draw(path, of) {
  if (busy) {
    wanted = [path, of];
    return;
  }
  busy = true;
  try {
    await showPicture($("picture"), path, () => of === scene?.id);
    tell($("view-problem"), null);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    tell($("view-problem"), error.problem);
  } finally {
    busy = false;
  }
  const next = wanted;
  wanted = null;
  if (next && next[1] === scene?.id) draw(...next);
}

function look(small) {
  if (!scene) return;
  const turn = orbit.moved ? `, turned by ${orbit.azimuth.toFixed(0)}° and ${orbit.elevation.toFixed(0)}°` : "";
  const begin = mode === "webgl" ? "beginning at " : "";
  const place = `${begin}${scene.file ? "" : "input "}view ${orbit.view}${turn}`;
  const how = mode === "webgl" ? "Drag, pinch or scroll in the picture." : "Drag the picture, or use the arrow keys, to orbit; + and − to come nearer.";
  $("caption").textContent = `${place[0].toUpperCase()}${place.slice(1)}. ${how}`;
  $("picture").alt = `Scene ${scene.id}, ${place}`;
  draw(pictureOf(small), scene.id);
}

function move(right, up, factor) {
  orbit.move(right, up, factor);
  look(true);
  clearTimeout(settle);
  settle = setTimeout(() => look(false), SETTLE_MS);
}

/** Show a scene document, or nothing. */
export function showScene(document_) {
  scene = document_;
  orbit = scene && new Orbit(scene.view_cameras, scene.near, scene.far);
  clearTimeout(settle);
  $("controls").hidden = !scene;
  $("empty").hidden = Boolean(scene);
  $("caption").textContent = "";
  $("picture").removeAttribute("src");
  tell($("view-problem"), null);
  if (scene) {
    $("stage").style.aspectRatio = `${scene.view_cameras[0].width} / ${scene.view_cameras[0].height}`;
    $("views").replaceChildren(...scene.view_cameras.map((_, index) => button(`View ${index}`, () => {
      orbit.reset(index);
      if (mode === "webgl") setMode("server");
      else look(false);
    })));
  }
  showFrame();
  look(false);
}

/** The picture on show, for others to compare with: its path. */
export const shownPicture = () => (scene ? pictureOf(false) : null);

$("full").hidden = !document.fullscreenEnabled;
$("full").addEventListener("click", () => $("stage").requestFullscreen());
$("mode-webgl").addEventListener("click", () => setMode("webgl"));
$("mode-server").addEventListener("click", () => setMode("server"));
$("channel").addEventListener("change", () => look(false));
$("stage").addEventListener("pointerdown", (event) => {
  if (!scene || mode === "webgl") return;
  $("stage").setPointerCapture(event.pointerId);
  $("stage").classList.add("dragging");
});
$("stage").addEventListener("pointermove", (event) => {
  if (!scene || mode === "webgl" || !event.buttons || !(event.movementX || event.movementY)) return;
  move(-event.movementX * DEGREES_PER_PX, event.movementY * DEGREES_PER_PX);
});
for (const name of ["pointerup", "pointercancel"]) {
  $("stage").addEventListener(name, () => $("stage").classList.remove("dragging"));
}
$("stage").addEventListener("wheel", (event) => {
  if (!scene || mode === "webgl") return;
  event.preventDefault();
  move(0, 0, Math.exp(-event.deltaY * 0.001));
}, { passive: false });
$("stage").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: [-3, 0], ArrowRight: [3, 0], ArrowUp: [0, 3], ArrowDown: [0, -3], "+": [0, 0, 1.1], "-": [0, 0, 1 / 1.1] }[event.key];
  if (!step || !scene || mode === "webgl") return;
  event.preventDefault();
  move(...step);
});
