// The table of inputs: photograph, render, depth and routing of each view, loaded when they become visible.

import { showPicture } from "./api.js";
import { make, percent } from "./dom.js";
import { legend, routingPicture, TASKS } from "./routing.js";
import { decibels, head, row, wide } from "./table.js";

const KINDS = ["experts", "tasks"];
const LEAST = 256;    // px: pictures are not requested narrower
const NARROWEST = 7;  // rem, a column
const AHEAD = "100%"; // of the window's height: rows within it are loaded in advance

/** Fill `body` with a row for each view, and columns for what exists. */
export function inputs(body, scene) {
  const maps = scene.routing?.maps ?? {};
  const kinds = KINDS.filter((kind) => maps[kind]);
  const columns = [...(scene.links.inputs ? ["photograph"] : []), "drawn again", "depth", ...kinds];
  const table = make("table", { class: "inputs" }, head(...columns));
  table.style.minWidth = `${NARROWEST * columns.length}rem`;
  let line = Promise.resolve(); // rows are loaded one by one, so that the large view waits for one picture at most
  const fillings = new Map();
  const seen = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) continue;
      seen.unobserve(target);
      line = line.then(() => target.isConnected && fillings.get(target)()); // else another scene is shown
    }
  }, { rootMargin: `${AHEAD} 0px` });
  scene.view_cameras.forEach((camera, index) => {
    const { node, fill } = view(scene, camera, index, kinds);
    fillings.set(node, fill);
    table.append(node);
    seen.observe(node);
  });
  body.append(wide(table));
  if (maps.experts) body.append(make("p", {}, "Experts: "), legend(maps.experts));
  if (maps.tasks) body.append(make("p", {}, "Tasks: "), legend(maps.tasks, TASKS));
}

/** The row of a view, and what fills it. */
function view(scene, camera, index, kinds) {
  const figure = (picture, text) => make("figure", {}, picture, make("figcaption", {}, text));
  const image = (alt) => make("img", { width: camera.width, height: camera.height, alt });
  const photograph = scene.links.inputs && image(`Photograph ${index}`);
  const again = image(photograph ? `Photograph ${index}, drawn again` : `View ${index}`);
  const depth = image(`Depth from view ${index}`);
  const share = scene.crop?.[index]?.kept_share;
  const middle = share < 0.95 ? `, its middle ${percent(share)}` : "";
  const found = scene.check?.input_views?.[index];
  const places = kinds.map(() => make("span"));
  const node = row(
    ...(photograph ? [figure(photograph, `input ${index}${middle}`)] : []),
    figure(again, found ? decibels(found) : `view ${index}`),
    figure(depth, "near is dark"),
    ...places,
  );

  async function fill() {
    const width = Math.max(LEAST, Math.ceil(again.clientWidth * devicePixelRatio));
    const drawn = scene.links.views[index] + (width < camera.width ? `&width=${width}` : "");
    try {
      if (photograph) await showPicture(photograph, scene.links.inputs[index]);
      await showPicture(again, drawn);
      await showPicture(depth, `${drawn}&channel=depth`);
    } catch (error) {
      node.lastChild.append(error.message);
      return;
    }
    await photograph?.decode().catch(() => undefined);
    kinds.forEach((kind, place) => {
      const label = `${kind} of the patches of view ${index}`;
      const picture = routingPicture(scene.routing.maps[kind][index], scene.model, camera, photograph, label);
      places[place].append(figure(picture, kind));
    });
  }
  return { node, fill };
}
