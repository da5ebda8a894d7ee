// The frame in which WebGL draws: the scene that it holds, how far its file has come, and whether it drew.

import { $, digits, make } from "./dom.js";

const PATIENCE_MS = 30000; // for the frame's next sign: a piece of the file, or the first picture

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
  for (const name of ["drop", "pointermove"]) document.addEventListener(name, () => letFilesThrough(false)); // none moves while it carries
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && letFilesThrough(false));
}

/** Show a scene by its id, or (null) nothing. */
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

/** What is carried over the frame, a document of its own, is the page's to take. */
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
  if (shown === null || data.scene !== shown) return; // of the scene that was there before
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

/** How much of the scene's file has come; of some files (`all` = 0) nobody said how long they are. */
function tellShare({ came, all }) {
  coming.hidden = false;
  amount.textContent = `${digits(came / 1e6)}${all ? ` of ${digits(all / 1e6)}` : ""} MB for WebGL have come `;
  if (all) [bar.max, bar.value] = [all, came];
  else bar.removeAttribute("value");
}
