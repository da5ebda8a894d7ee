// The list of stored scenes, newest first, with a small picture of each.

import { ask, askJson, showPicture } from "./api.js";
import { $, button, count, discard, make } from "./dom.js";

const PAGE = 12;
let next = null;
let turn = 0; // of lists: a late page of an earlier one is passed over
let chosen = null;
let act = {};

/** `open(id)` and `removed(id)` are called for what is chosen and deleted. */
export function prepareShelf(acts) {
  act = acts;
  $("more").addEventListener("click", async () => {
    $("more").disabled = true;
    await list(next).catch(act.failed);
    $("more").disabled = false;
  });
}

export const markChosen = (id) => {
  chosen = id;
  for (const item of $("scenes").children) item.classList.toggle("chosen", item.dataset.id === id);
};

/** The newest scenes anew; returns the id of the first, or null. */
export async function refreshShelf() {
  turn += 1;
  return list(null);
}

async function list(after) {
  const mine = turn;
  const query = new URLSearchParams({ limit: String(PAGE), ...(after ? { after } : {}) });
  const page = await askJson(`/scenes?${query}`);
  if (mine !== turn) return page.scenes[0]?.id ?? null;
  const held = document.activeElement?.closest("#scenes li");
  const place = held && { id: held.dataset.id, row: [...$("scenes").children].indexOf(held), quiet: document.activeElement.matches(".quiet") };
  if (!after) discard($("scenes"));
  next = page.next;
  $("more").hidden = next === null;
  $("scenes").append(...page.scenes.map(item));
  if (place && !after) refocus(place);
  return page.scenes[0]?.id ?? null;
}

/** The focus goes back to where it was in the list: to the same scene, or to the one that has its row now. */
function refocus({ id, row, quiet }) {
  const items = [...$("scenes").children];
  const item = items.find((one) => one.dataset.id === id) ?? items[Math.min(row, items.length - 1)];
  (item?.querySelector(quiet ? ".quiet" : "button") ?? $("files")).focus();
}

function item(scene) {
  const picture = make("img", { alt: "", width: 72, height: 72 });
  const open = make("button", { type: "button", "aria-label": `Show scene ${scene.id.slice(0, 8)} of ${scene.created}` }, picture);
  open.addEventListener("click", () => act.open(scene.id));
  const what = scene.file ? `from a .${scene.file}, ` : `${scene.views} views, `;
  const node = make("li", { "data-id": scene.id }, open, make("div", {},
    make("p", {}, `${what}${count(scene.gaussians ?? 0)} Gaussians`),
    make("p", { class: "small" }, make("time", { datetime: scene.created }, new Date(scene.created).toLocaleString())),
    make("p", { class: "small" }, make("code", {}, scene.id.slice(0, 8)), " ", button("Delete", () => remove(scene.id), { class: "quiet", "aria-label": `Delete scene ${scene.id.slice(0, 8)}` })),
  ));
  node.classList.toggle("chosen", scene.id === chosen);
  const seen = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    seen.disconnect();
    showPicture(picture, `${scene.links.views[0]}&height=72&format=jpeg`).catch(() => picture.classList.add("missing"));
  });
  seen.observe(picture);
  return node;
}

/** Delete a scene, once it was asked whether. */
export async function remove(id) {
  if (!confirm(`Delete scene ${id.slice(0, 8)}? Its files are gone then.`)) return;
  try {
    await ask(`/scenes/${encodeURIComponent(id)}`, { method: "DELETE" });
  } catch (error) {
    if (error.status !== 404) return void act.failed(error);
  }
  act.removed(id);
}
