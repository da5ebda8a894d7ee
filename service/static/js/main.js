// The page's beginning: what the address asks for, and who tells whom.

import { ask, askJson, setKey, Refused } from "./api.js";
import { showAbout } from "./about.js";
import { $, tell } from "./dom.js";
import { attend, prepareMaking, prepareModels } from "./making.js";
import { markChosen, prepareShelf, refreshShelf, remove } from "./shelf.js";
import { prepareStage, showScene } from "./stage.js";

let scene = null;

const failed = (error) => {
  if (!(error instanceof Refused)) throw error;
  tell($("view-problem"), error.problem);
};

async function open(id, { push = true } = {}) {
  try {
    scene = await askJson(`/scenes/${encodeURIComponent(id)}`);
  } catch (error) {
    scene = null;
    show();
    return failed(error);
  }
  const address = `/?scene=${id}`;
  if (push && location.search !== `?scene=${id}`) history.pushState(null, "", address);
  else history.replaceState(null, "", address);
  show();
  return undefined;
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
  if (first) return open(first);
  scene = null;
  history.replaceState(null, "", "/");
  return show();
}

async function awaitReady() {
  for (;;) {
    try {
      const { model } = await (await ask("/readyz")).json();
      $("state").textContent = `Network ${model.preset}, ${model.width} × ${model.height} px.`;
      return;
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      $("state").textContent = error.problem.detail;
      if (error.problem.state === "failed") return;
    }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

/** What the address asks for: a job to follow, a scene to show, or the newest. */
async function begin() {
  const asked = new URLSearchParams(location.search);
  try {
    await prepareModels();
    const newest = await refreshShelf();
    if (asked.has("job")) return void attend(asked.get("job"));
    if (asked.has("scene")) await open(asked.get("scene"), { push: false });
    else if (newest) await open(newest, { push: false });
  } catch (error) {
    failed(error);
  }
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
  begin();
});
document.addEventListener("key-needed", () => { $("key-form").hidden = false; });
window.addEventListener("popstate", begin);

prepareMaking(made);
prepareShelf({ open, removed, failed });
await awaitReady();
await prepareStage();
await begin();
