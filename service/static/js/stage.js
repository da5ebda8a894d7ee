// The large view: drawn by the service, or by WebGL in a frame if browser and service support it.

import { ask, askPicture, Refused } from "./api.js";
import { $, button, tell } from "./dom.js";
import { prepareFrame, showFrame } from "./frame.js";
import { Orbit } from "./orbit.js";
import { turnBy } from "./turning.js";

const SMALL = 128;         // px, longer side while it moves
const LARGEST = 2048;      // px, longer side of any other picture: cameras of a file may have more than a service draws
const SETTLE_MS = 150;     // after the last movement the full picture is drawn
const LABELS = {
  server: "The scene. Drag, or press the arrow keys, to orbit; plus and minus to move closer and away",
  webgl: "The scene, in an interactive frame",
};

let scene = null;
let orbit = null;
let busy = false;   // one request in flight
let wanted = null;  // the newest picture that was asked for meanwhile
let complained = false; // whether the problem on show is one of drawing
let settle = 0;     // the wait for the full picture; 0 when there is none
let mode = "server";

/** Whether this browser has WebGL 2, and whether that is rendered in software. */
function graphics() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return { there: false, slow: true };
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return { there: true, slow: /swiftshader|llvmpipe|software|basic render/i.test(name) };
}

/** Choose between service and WebGL, which is preferred with hardware acceleration. */
export async function prepareStage() {
  const { there, slow } = graphics();
  let reason = there ? "" : "this browser has no WebGL 2";
  if (there) {
    try {
      await ask("/viewer");
    } catch (error) {
      reason = error.status === 404 ? "the service was built without the WebGL viewer" : error.message;
    }
  }
  $("mode-webgl").disabled = reason !== "";
  note(reason);
  setMode(reason === "" && !slow ? "webgl" : "server");
}

/** Why WebGL does not draw. */
function note(reason) {
  $("mode-note").textContent = reason ? `Without WebGL: ${reason}.` : "";
}

function setMode(next) {
  mode = next;
  for (const name of ["webgl", "server"]) $(`mode-${name}`).setAttribute("aria-pressed", String(name === mode));
  for (const id of ["channel", "nearer", "farther"]) $(id).disabled = mode === "webgl";
  $("stage").setAttribute("aria-label", LABELS[mode]);
  frameScene();
  look(false);
}

const frameScene = () => showFrame(scene && mode === "webgl" ? scene.id : null);

function giveUp(reason) {
  if (mode !== "webgl") return;
  note(reason);
  setMode("server");
}

function pictureOf(small) {
  const channel = $("channel").value;
  const query = new URLSearchParams({ scene: scene.id, channel, format: small && channel === "rgb" ? "jpeg" : "png" });
  const camera = scene.view_cameras[orbit.view];
  if (orbit.moved) query.set("camera", JSON.stringify(orbit.camera()));
  else query.set("view", String(orbit.view));
  const most = small ? SMALL : LARGEST;
  if (small || Math.max(camera.width, camera.height) > most) query.set(camera.width >= camera.height ? "width" : "height", String(most));
  return `/render?${query}`;
}

function show(address) {
  const picture = $("picture");
  if (picture.src.startsWith("blob:")) URL.revokeObjectURL(picture.src);
  if (address) picture.src = address;
  else picture.removeAttribute("src");
}

/** Set aria-busy while a picture is pending. */
function tellWhetherBusy() {
  $("stage").setAttribute("aria-busy", String(busy || wanted !== null || settle !== 0));
}

async function draw(path, of) {
  if (busy) {
    wanted = [path, of];
    return;
  }
  busy = true;
  tellWhetherBusy();
  try {
    const address = await askPicture(path);
    if (of === scene?.id) show(address);
    else URL.revokeObjectURL(address); // another scene was chosen meanwhile
    complain(null);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (of === scene?.id) complain(error);
  } finally {
    busy = false;
    const next = wanted;
    wanted = null;
    if (next && next[1] === scene?.id) draw(...next);
    else tellWhetherBusy();
  }
}

/** Show a problem of drawing, or clear it; other problems stay. */
function complain(error) {
  if (error || complained) tell($("view-problem"), error);
  complained = error !== null;
}

function look(small) {
  if (!scene) return;
  draw(pictureOf(small), scene.id);
  if (small) return; // screen readers hear of the final picture only
  const turn = orbit.moved ? `, turned by ${orbit.azimuth.toFixed(0)}° and ${orbit.elevation.toFixed(0)}°` : "";
  const place = `${mode === "webgl" ? "starting at " : ""}${scene.file ? "" : "input "}view ${orbit.view}${turn}`;
  const how = mode === "webgl" ? "Drag, pinch or scroll in the picture." : "Drag the picture, or use the arrow keys, to orbit; + and − to move closer or away.";
  $("caption").textContent = `${place[0].toUpperCase()}${place.slice(1)}. ${how}`;
  $("picture").alt = `Scene ${scene.id}, ${place}`;
}

/** The id of the scene on show, or null. */
export const shown = () => scene?.id ?? null;

/** Show a scene document, or nothing. */
export function showScene(document_) {
  scene = document_;
  document.title = scene ? `${scene.id.slice(0, 8)} · gapmes` : "gapmes";
  orbit = scene && new Orbit(scene.view_cameras, scene.near, scene.far);
  clearTimeout(settle);
  settle = 0;
  tellWhetherBusy();
  $("controls").hidden = !scene;
  $("empty").hidden = Boolean(scene);
  $("caption").textContent = "";
  show(null);
  tell($("view-problem"), null);
  if (scene) {
    $("stage").style.aspectRatio = `${scene.view_cameras[0].width} / ${scene.view_cameras[0].height}`;
    $("views").replaceChildren(...scene.view_cameras.map((_, index) => button(`View ${index}`, () => {
      orbit.reset(index);
      if (mode === "webgl") setMode("server");
      else look(false);
    })));
  }
  frameScene();
  look(false);
}

/** Orbit by degrees to the right and upwards, and zoom by a factor; whether that was possible. */
function move(right, up, factor) {
  if (!scene || mode === "webgl") return false;
  orbit.move(right, up, factor);
  clearTimeout(settle);
  settle = setTimeout(() => {
    settle = 0;
    look(false);
  }, SETTLE_MS);
  look(true);
  return true;
}

prepareFrame({ drawn: () => note(""), failed: giveUp });
turnBy($("stage"), move);
$("nearer").addEventListener("click", () => move(0, 0, 1.2));
$("farther").addEventListener("click", () => move(0, 0, 1 / 1.2));
$("full").hidden = !document.fullscreenEnabled;
$("full").addEventListener("click", () => {
  $("stage").requestFullscreen();
  $(mode === "webgl" ? "frame" : "stage").focus(); // for the keys that turn it
});
$("mode-webgl").addEventListener("click", () => setMode("webgl"));
$("mode-server").addEventListener("click", () => setMode("server"));
$("channel").addEventListener("change", () => look(false));
