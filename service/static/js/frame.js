// The iframe of the WebGL viewer: its scene, the progress of its download, and whether it has drawn.

import { $, digits, make } from "./dom.js";

const PATIENCE_MS = 30000; // timeout for the frame's next message: progress, or the first picture

let shown = null;   // the id of the scene in the frame
let drawn = false;
let wait = 0;
let heard = {};

const amount = make("span");
const bar = make("progress", { "aria-label": "File for WebGL" });
const coming = make("p", { id: "coming", class: "small", hidden: "" }, amount, bar);

/** `drawn()` and `failed(reason)` are called for the scene in the frame, and for no other. */
export function prepareFrame(acts) {
  heard = acts;
  $("mode-note").after(coming);
  window.addEventListener("message", hear);
  for (const name of ["dragenter", "dragover"]) document.addEventListener(name, () => letFilesThrough(true));
  for (const name of ["drop", "pointermove"]) document.addEventListener(name, () => letFilesThrough(false)); // no pointer moves during a drag
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && letFilesThrough(false));
}

/** Show the scene of this id; null for none. */
export function showFrame(id) {
  const frame = $("frame");
  if (id !== shown) {
    shown = id;
    settle(false);
    // `src` would add a step to the page's history
    frame.contentWindow.location.replace(id === null ? "about:blank" : `/viewer?scene=${encodeURIComponent(id)}`);
  }
  frame.hidden = !drawn;
  if (shown === null || drawn) clearTimeout(wait);
  else awaitSign();
}

/** While files are dragged, let the page receive them instead of the frame, a document of its own. */
function letFilesThrough(carried) {
  $("frame").style.pointerEvents = carried ? "none" : "";
}

function awaitSign() {
  clearTimeout(wait);
  wait = setTimeout(() => heard.failed("it drew nothing in time"), PATIENCE_MS);
}

function settle(now) {
  drawn = now;
  $("frame").dataset.drawn = drawn ? "yes" : "";
  coming.hidden = true;
}

function hear({ origin, source, data }) {
  if (origin !== location.origin || source !== $("frame").contentWindow) return;
  if (data.viewer === "carried") letFilesThrough(true);
  if (shown === null || data.scene !== shown) return; // about the previous scene
  if (data.viewer === "drawn") {
    clearTimeout(wait);
    settle(true);
    $("frame").hidden = false;
    heard.drawn();
  } else if (data.viewer === "failed") {
    heard.failed(data.reason);
  } else if (data.viewer === "came" && !drawn) {
    awaitSign();
    tellShare(data);
  }
}

/** Show the progress of the download in bytes; `all` = 0 if the length is unknown. */
function tellShare({ came, all }) {
  coming.hidden = false;
  amount.textContent = `${digits(came / 1e6)}${all ? ` of ${digits(all / 1e6)}` : ""} MB loaded for WebGL `;
  if (all) [bar.max, bar.value] = [all, came];
  else bar.removeAttribute("value");
}
