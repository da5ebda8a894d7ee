// The routing picture: which expert, or which task, weighs most for each patch of an input.

import { colourOf, make, swatch } from "./dom.js";

export const TASKS = ["mean", "opacity", "covariance", "colour"];

/** A canvas of the view's size: the grey photograph, tinted by the expert or task of each patch of the network's input,
 * which has the shape of `model` and shows the whole photograph. */
export function routingPicture(digits, model, camera, photograph, label) {
  const canvas = make("canvas", { width: camera.width, height: camera.height, role: "img", "aria-label": label });
  const context = canvas.getContext("2d");
  const kinds = [...digits].map((digit) => parseInt(digit, 36));
  const columns = Math.round(Math.sqrt((kinds.length * model.width) / model.height));
  const width = camera.width / columns;
  const height = (camera.height * columns) / kinds.length;
  if (photograph?.complete && photograph.naturalWidth) {
    context.filter = "grayscale(1)";
    context.drawImage(photograph, 0, 0, camera.width, camera.height);
    context.filter = "none";
  }
  context.globalAlpha = 0.55;
  kinds.forEach((kind, patch) => {
    context.fillStyle = colourOf(kind);
    context.fillRect((patch % columns) * width, Math.floor(patch / columns) * height, width, height);
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
    return make("li", {}, swatch(colourOf(kind)), ` ${names ? names[kind] : `expert ${kind}`} ${Math.round(100 * share)} %`);
  }));
}
