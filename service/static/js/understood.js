// The answer of POST /check as a sentence, cards, a top view and warnings.

import { warned } from "./cures.js";
import { colourOf, digits, make, swatch } from "./dom.js";
import { plan } from "./plan.js";

const SOURCES = { cameras: "estimated from the cameras; the photographs will narrow it" };

/** Words about an answer of POST /check, and the elements that show it. */
export function understood({ images, near, far, depth_range_source: source, paired_by: by, warnings, selection }) {
  const chosen = selection.by === "score" ? `${images.length} of ${selection.of} photographs, chosen for their overlap and baselines. ` : "";
  return [
    `${chosen}Cameras paired by ${by}. Depth from ${digits(near)} to ${digits(far)} (${SOURCES[source] ?? source}), in the cameras' units.`,
    make("ul", { class: "cards" }, ...images.map(card)),
    plan(images.map((image) => image.camera), near, far),
    ...warnings.map((warning) => make("p", { class: "warning" }, make("strong", {}, "Note: "), warned(warning))),
  ];
}

function card({ name, width, height, camera, thumbnail }, index) {
  const angle = (2 * Math.atan((0.5 * camera.width) / camera.fx) * 180) / Math.PI;
  const bytes = Uint8Array.from(atob(thumbnail), (letter) => letter.charCodeAt(0));
  const picture = make("img", { alt: "", src: URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" })) });
  return make("li", {}, picture,
    make("p", {}, swatch(colourOf(index)), ` ${index}: ${name}`),
    make("p", { class: "small" }, `${width} × ${height} px, ${angle.toFixed(0)}° wide`));
}
