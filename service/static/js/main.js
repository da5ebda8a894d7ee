// The page's beginning: what the address asks for, and who tells whom.

import { askJson, Refused, setKey } from "./api.js";
import { showAbout } from "./about.js";
import { $, tell } from "./dom.js";
import { attend, prepareMaking, prepareModels } from "./making.js";
import { markChosen, prepareShelf, refreshShelf, remove } from "./shelf.js";
import { prepareStage, showScene } from "./stage.js";

let scene = null;
let turn = 0; // of openings: a late answer to an earlier one is passed over

const failed = (error) => {
  if (!(error instanceof Refused)) throw error;
  tell($("view-problem"), error);
};

/** Show a scene; `push`: as a step of its own to come back from. */
async function open(id, { push = true } = {}) {
  const mine = (turn += 1);
  let found = null;
  try {
    found = await askJson(`/scenes/${encodeURIComponent(id)}`);
  } catch (error) {
    if (mine !== turn) return;
    scene = null;
    show();
    failed(error);
    return;
  }
  if (mine !== turn) return;
  scene = found;
  const address = `/?scene=${id}`;
  const here = location.search === `?scene=${id}` || location.search.startsWith("?job="); // nobody goes back to a job
  if (push && !here) history.pushState(null, "", address);
  else history.replaceState(null, "", address);
  show();
}

function show() {
  showScene(scene);
  showAbout($("about"), scene);
  markChosen(scene?.id ?? null);
}

async function made(id) {
  await refreshShelf().catch(failed);
  await open(id);
  $("stage").scrollIntoView({ block: "nearest" });
}

async function removed(id) {
  const first = await refreshShelf().catch(failed);
  if (scene?.id !== id) return markChosen(scene?.id ?? null);
  if (first) return open(first, { push: false });
  scene = null;
  history.replaceState(null, "", "/");
  return show();
}

/** Wait while the service starts; whatever else is wrong with it, what it can do is shown. */
async function awaitReady() {
  for (;;) {
    try {
      const { model } = await askJson("/readyz");
      $("state").textContent = `Network ${model.preset}, ${model.width} × ${model.height} px.`;
      return;
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      $("state").textContent = error.problem.detail;
      if (error.status !== 0 && error.problem.state !== "starting") return;
    }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

/** What the address asks for: a job to follow, a scene to show, or the newest. */
async function begin() {
  const asked = new URLSearchParams(location.search);
  tell($("view-problem"), null);
  try {
    const newest = await refreshShelf();
    if (asked.has("job")) await attend(asked.get("job"));
    else if (asked.has("scene")) await open(asked.get("scene"), { push: false });
    else if (newest) await open(newest, { push: false });
    else show();
  } catch (error) {
    failed(error);
  }
}

/** What needs the key where there is one. */
async function unlocked() {
  await prepareModels().catch(failed);
  await begin();
}

$("share").addEventListener("click", async () => {
  const link = `${location.origin}/?scene=${scene.id}`;
  try {
    await navigator.clipboard.writeText(link);
    $("share").textContent = "Link copied";
  } catch {
    prompt("The link to this scene:", link); // no clipboard without https
  }
  setTimeout(() => { $("share").textContent = "Copy link"; }, 2000);
});
$("remove").addEventListener("click", () => scene && remove(scene.id));
$("key-form").addEventListener("submit", (event) => {
  event.preventDefault();
  setKey($("key").value);
  $("key-form").hidden = true;
  unlocked();
});
document.addEventListener("key-needed", () => {
  if (!$("key-form").hidden) return;
  $("key-form").hidden = false;
  $("key").focus();
});
window.addEventListener("popstate", begin);

prepareMaking(made);
prepareShelf({ open, removed, failed });
await awaitReady();
await prepareStage();
await unlocked();
$("main").setAttribute("aria-busy", "false");
