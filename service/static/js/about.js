// The panel beside the view: downloads, inputs and renders, what was left out, the self-check, cameras and timings.

import { warned } from "./cures.js";
import { count, digits, discard, make, percent } from "./dom.js";
import { downloading } from "./downloads.js";
import { inputs } from "./inputs.js";
import { plan } from "./plan.js";
import { decibels, head, row, wide } from "./table.js";

/** A collapsible section that is filled when it is first opened. */
function part(title, fill, open = false) {
  const body = make("div");
  const details = make("details", {}, make("summary", {}, title), body);
  let filled = false;
  details.addEventListener("toggle", () => {
    if (!details.open || filled) return;
    filled = true;
    fill(body);
  });
  details.open = open;
  return details;
}

/** Fill the panel from a scene document; empty it for null. */
export function showAbout(target, scene) {
  discard(target);
  if (!scene) return;
  for (const warning of scene.warnings ?? []) target.append(make("p", { class: "warning" }, make("strong", {}, "Note: "), warned(warning)));
  target.append(files(scene));
  target.append(part(scene.links.inputs ? "Inputs beside their pictures" : "Views and their depth", (body) => inputs(body, scene), true));
  if (scene.left_out?.length) target.append(part("What was left out, and what it cost", (body) => leftOut(body, scene)));
  if (scene.check?.input_views) target.append(part("How far to trust the scene", (body) => trust(body, scene)));
  target.append(part("Cameras and timings", (body) => timings(body, scene)));
}

function files(scene) {
  const told = make("div", { id: "download-told", role: "alert" });
  const link = (path, name, text) => downloading(path, name, text, told);
  const links = Object.entries(scene.links.files).map(([kind, path]) => link(path, `${scene.id}.${kind}`, `.${kind}`));
  links.push(link(scene.links.preview, `${scene.id}.webp`, "animation"), link(scene.links.sheet, `${scene.id}.png`, "contact sheet"));
  const corrected = (scene.warnings ?? []).some(({ code }) => code === "poses_refined"); // others would miss the scene
  const cameras = URL.createObjectURL(new Blob([JSON.stringify({ near: scene.near, far: scene.far, views: corrected ? scene.view_cameras : scene.cameras }, null, 1)], { type: "application/json" }));
  links.push(make("a", { href: cameras, download: "cameras.json" }, "cameras.json"), link(scene.links.self, `${scene.id}.json`, "scene document"));
  const list = make("p", { id: "downloads" }, "Download: ");
  links.forEach((one, index) => list.append(index ? " · " : "", one));
  list.append(make("br"), `${count(scene.gaussians.count)} Gaussians, harmonics of degree ${scene.gaussians.sh_degree}`);
  return make("div", {}, list, told);
}

function leftOut(body, scene) {
  const table = make("table", {}, head("what", "left out", "of", "change of a colour"));
  for (const { what, count: some, of, error } of scene.left_out) {
    table.append(row(what, count(some), count(of), error === null ? "not measured" : error === 0 ? "none" : `at most ${digits(error)}`));
  }
  body.append(wide(table));
  const pruning = scene.pruning;
  if (!pruning) return;
  const found = pruning.actual === null ? "" : ` Found in the inputs' pictures: ${digits(pruning.actual)}.`;
  const proved = pruning.bound === null ? "" : `No colour of the certified views changes by more than ${digits(pruning.bound)} (of 1).${found} `;
  const saved = pruning.bytes_saved ? `The file is ${count(pruning.bytes_saved)} bytes smaller` : "The budget left out no Gaussian";
  body.append(make("p", {}, `${proved}${saved}; deciding this took ${digits(pruning.seconds)} s.`));
}

const foretold = (entry) => (entry.from.length ? `${decibels(entry)} from ${entry.from.join(", ")}` : "–");

function trust(body, scene) {
  const check = scene.check;
  const columns = ["view", "drawn again", "holes"];
  if (check.from_others) columns.push("from the others' Gaussians");
  if (check.leave_one_out) columns.push("predicted without it");
  const table = make("table", {}, head(...columns));
  check.input_views.forEach((view, index) => {
    const cells = [String(index), decibels(view), view.holes === null ? "–" : percent(view.holes)];
    if (check.from_others) cells.push(decibels(check.from_others[index]));
    if (check.leave_one_out) cells.push(foretold(check.leave_one_out[index]));
    table.append(row(...cells));
  });
  body.append(wide(table));
  const facts = [
    `${percent(check.textureless_share)} of the pixels have no texture around them, ${percent(check.no_parallax_share)} no parallax: depth there is a guess.`,
  ];
  const step = check.depth_step;
  if (step) facts.push(`Half a depth step is ${percent(step.near)} of the depth at the near end and ${percent(step.far)} at the far end.`);
  if (check.ambiguous_routes) facts.push(`For ${percent(check.ambiguous_routes)} of the patches rounding may decide the route.`);
  const fading = scene.fading;
  if (fading?.passes) facts.push(`Where the photographs contradict them, ${count(fading.halved)} Gaussians lost half of their opacity or more, and ${count(fading.gone)} are no longer drawn.`);
  if (fading?.recoloured) facts.push(`Colours moved towards the photographs by ${percent(fading.recoloured)} on average.`);
  body.append(make("p", {}, facts.join(" ")));
}

function timings(body, scene) {
  const entries = Object.entries(scene.timings ?? {});
  const longest = Math.max(...entries.map(([, seconds]) => seconds), 1e-9);
  const table = make("table", {}, ...entries.map(([stage, seconds]) => {
    const bar = make("meter", { min: 0, max: longest, value: seconds, "aria-hidden": "true" });
    return make("tr", {}, make("th", { scope: "row" }, stage), make("td", {}, `${seconds.toFixed(2)} s`), make("td", {}, bar));
  }));
  const depths = `Depth from ${digits(scene.near)} to ${digits(scene.far)} (${scene.depth_range_source}), in the cameras' units.`;
  body.append(plan(scene.view_cameras, scene.near, scene.far), make("p", {}, depths), wide(table));
  const model = scene.model;
  if (model?.weights_sha256) {
    body.append(make("p", { class: "small" }, `Network ${model.preset}, ${model.precision}, ${model.width} × ${model.height} px, weights ${model.weights_sha256.slice(0, 12)}, ${model.licence}`));
  }
}
