// The list of stored scenes, newest first, with a small picture of each.

import { ask, askJson, showPicture } from "./api.js";
import { $, button, count, discard, make, tell } from "./dom.js";

const PAGE = 12;
const MOST = 1000; // largest page of the service
let next = null;
let turn = 0; // number of the latest list; late pages of earlier ones are ignored
let asking = 0; // lists on their way, which may hold scenes that are deleted meanwhile
let chosen = null;
let act = {};
let unread = null; // the node that tells that the list could not be read

const problem = make("div", { id: "shelf-problem", class: "problem", role: "alert" });

/** `open(id)`, which throws what it is refused by, and `removed(id)` are called for what is chosen and deleted. */
export function prepareShelf(acts) {
  act = acts;
  $("scenes").before(problem);
  $("more").addEventListener("click", older);
  document.addEventListener("visibilitychange", () => document.hidden || reread().catch(() => undefined)); // else it stays as it is
}

const rows = () => [...$("scenes").children];

const rowOf = (id) => rows().find((row) => row.dataset.id === id);

/** The ids of the scenes of the list. */
export const ids = () => rows().map((row) => row.dataset.id);

/** The id of the first scene of the list, or null. */
export const first = () => ids()[0] ?? null;

export function markChosen(id) {
  chosen = id;
  rows().forEach(mark);
}

function mark(row) {
  const shown = row.dataset.id === chosen;
  row.classList.toggle("chosen", shown);
  if (shown) row.querySelector("button").setAttribute("aria-current", "true");
  else row.querySelector("button").removeAttribute("aria-current");
}

/** Reload as many scenes as are listed; returns the id of the newest, or null if there is none. What it is refused by is shown at the list, or where a key is asked for; undefined then. */
export async function refreshShelf() {
  const mine = turn + 1;
  try {
    return await reread();
  } catch (error) {
    if (mine !== turn) return undefined;
    act.failed(error, error.status === 401 ? null : problem); // the key is asked for above
    unread = problem.firstChild;
    return undefined;
  }
}

async function reread() {
  const mine = (turn += 1);
  const page = await list(Math.min(MOST, Math.max(PAGE, rows().length)), null);
  if (unread?.isConnected) tell(problem, null);
  if (mine !== turn) return page.scenes[0]?.id ?? null;
  next = page.next;
  $("more").hidden = next === null;
  const there = new Set(page.scenes.map(({ id }) => id));
  for (const row of rows()) if (!there.has(row.dataset.id)) drop(row);
  page.scenes.forEach((scene, place) => {
    const row = rowOf(scene.id) ?? item(scene);
    const now = $("scenes").children[place] ?? null;
    if (now !== row) $("scenes").insertBefore(row, now);
  });
  return first();
}

async function list(limit, after) {
  asking += 1;
  try {
    return await askJson(`/scenes?${new URLSearchParams({ limit: String(limit), ...(after ? { after } : {}) })}`);
  } finally {
    asking -= 1;
  }
}

/** Append the next page, and focus its first scene. */
async function older() {
  $("more").disabled = true;
  const mine = turn;
  try {
    const page = await list(PAGE, next);
    if (mine !== turn) return;
    tell(problem, null);
    next = page.next;
    const fresh = page.scenes.filter(({ id }) => !rowOf(id)).map(item);
    $("scenes").append(...fresh);
    if ([null, document.body, $("more")].includes(document.activeElement)) fresh[0]?.querySelector("button").focus();
    $("more").hidden = next === null;
  } catch (error) {
    act.failed(error, problem);
  } finally {
    $("more").disabled = false;
  }
}

/** Remove a row; its focus goes to the row that takes its position, or to the file input. */
function drop(row) {
  const place = rows().indexOf(row);
  const held = row.contains(document.activeElement) && document.activeElement;
  discard(row);
  row.remove();
  if (held) (rows()[Math.min(place, rows().length - 1)]?.querySelector(held.matches(".quiet") ? ".quiet" : "button") ?? $("files")).focus();
}

/** Remove the row of a deleted scene; if the list is empty then, or being read, read it anew. */
async function gone(id) {
  const row = rowOf(id);
  if (row) drop(row);
  if (asking || (!first() && next !== null)) await refreshShelf();
}

async function choose(id) {
  tell(problem, null);
  try {
    await act.open(id);
    $("stage").scrollIntoView({ block: "nearest" });
  } catch (error) {
    act.failed(error, problem);
    if (error.status === 404) await gone(id);
  }
}

function item(scene) {
  const picture = make("img", { alt: "", width: 72, height: 72 });
  const created = new Date(scene.created).toLocaleString();
  const open = make("button", { type: "button", "aria-label": `Show scene ${scene.id.slice(0, 8)} of ${created}` }, picture);
  open.addEventListener("click", () => choose(scene.id));
  const what = scene.file ? `from a .${scene.file}, ` : `${scene.views} views, `;
  const node = make("li", { "data-id": scene.id }, open, make("div", {},
    make("p", {}, `${what}${count(scene.gaussians ?? 0)} Gaussians`),
    make("p", { class: "small" }, make("time", { datetime: scene.created }, created)),
    make("p", { class: "small" }, make("code", {}, scene.id.slice(0, 8)), " ", button("Delete", () => remove(scene.id, problem), { class: "quiet", "aria-label": `Delete scene ${scene.id.slice(0, 8)}` })),
  ));
  mark(node);
  const seen = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    seen.disconnect();
    showPicture(picture, `${scene.links.views[0]}&height=72&format=jpeg`).catch(() => undefined);
  });
  seen.observe(picture);
  return node;
}

/** Delete a scene after confirmation; errors are shown at `place`. */
export async function remove(id, place) {
  if (!confirm(`Delete scene ${id.slice(0, 8)}? Its files will be lost.`)) return;
  tell(place, null);
  try {
    await ask(`/scenes/${encodeURIComponent(id)}`, { method: "DELETE" }).catch((error) => {
      if (error.status !== 404) throw error; // else somebody was faster
    });
  } catch (error) {
    return act.failed(error, place);
  }
  await gone(id);
  await act.removed(id);
}
