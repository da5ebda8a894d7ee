// The routing picture: which expert, or which task, weighs most for each patch of an input.

import { make } from "./dom.js";

const EXPERTS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#999999"];
export const TASKS = ["mean", "opacity", "covariance", "colour"];

const colour = (kind) => EXPERTS[kind % EXPERTS.length];

/** Colours of the patches over the photograph's grey, as a canvas of the view's size. */
export function routingPicture(digits, camera, photograph, label) {
  const canvas = make("canvas", { width: camera.width, height: camera.height, role: "img", "aria-label": label });
  const context = canvas.getContext("2d");
  const kinds = [...digits].map((digit) => parseInt(digit, 36));
  const side = Math.sqrt((camera.width * camera.height) / kinds.length);
  const columns = Math.round(camera.width / side);
  if (photograph?.complete && photograph.naturalWidth) {
    context.filter = "grayscale(1)";
    context.drawImage(photograph, 0, 0, camera.width, camera.height);
    context.filter = "none";
  }
  context.globalAlpha = 0.55;
  kinds.forEach((kind, patch) => {
    context.fillStyle = colour(kind);
    context.fillRect((patch % columns) * side, Math.floor(patch / columns) * side, side, side);
  });
  return canvas;
}

/** What each colour means, with its share of all patches. */
export function legend(maps, names) {
  const all = maps.join("");
  const kinds = [...new Set(all)].sort();
  return make("ul", { class: "legend" }, ...kinds.map((digit) => {
    const kind = parseInt(digit, 36);
    const share = [...all].filter((one) => one === digit).length / all.length;
    const swatch = make("svg:svg", { viewBox: "0 0 12 12", width: 12, height: 12, "aria-hidden": "true" });
    swatch.append(make("svg:rect", { width: 12, height: 12, fill: colour(kind) }));
    return make("li", {}, swatch, ` ${names ? names[kind] : `expert ${kind}`} ${Math.round(100 * share)} %`);
  }));
}
