// The page's beginning: what the address asks for, and who tells whom.

import { askJson, checkedId, Refused, setKey } from "./api.js";
import { showAbout } from "./about.js";
import { $, tell } from "./dom.js";
import { following } from "./job.js";
import { attend, prepareMaking, prepareModels } from "./making.js";
import { markChosen, prepareShelf, refreshShelf, remove } from "./shelf.js";
import { prepareStage, showScene } from "./stage.js";

let scene = null;
let turn = 0; // of openings: a late answer to an earlier one is passed over

const failed = (error) => {
  if (!(error instanceof Refused)) throw error;
  tell($("view-problem"), error);
};

/** Show a scene; its `address` becomes a step to come back from, takes the place of the last one, or (null) is not told. Throws `Refused`. */
async function open(id, { address = "push" } = {}) {
  const mine = (turn += 1);
  let found = null;
  try {
    found = await askJson(`/scenes/${checkedId(id, "Scene")}`);
  } catch (error) {
    if (mine !== turn) return;
    throw error;
  }
  if (mine !== turn) return;
  scene = found;
  const own = `/?scene=${id}`;
  const here = location.search === `?scene=${id}` || location.search.startsWith("?job="); // nobody goes back to a job
  if (address === "push" && !here) history.pushState(null, "", own);
  else if (address !== null) history.replaceState(null, "", own);
  show();
}

function show() {
  showScene(scene);
  showAbout($("about"), scene);
  markChosen(scene?.id ?? null);
}

async function made(id) {
  await refreshShelf().catch(failed);
  await open(id).catch(failed);
  $("stage").scrollIntoView({ block: "nearest" });
}

async function removed(id) {
  const first = await refreshShelf().catch(failed);
  if (scene?.id !== id) return markChosen(scene?.id ?? null);
  if (first) return open(first, { address: "replace" }).catch(failed);
  scene = null;
  history.replaceState(null, "", "/");
  if (document.activeElement === $("remove")) $("files").focus(); // the button goes
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
    if (asked.has("job")) {
      await standIn(newest);
      if (!following()) attend(asked.get("job")); // the page does not wait for it
    } else if (asked.has("scene")) {
      try {
        await open(asked.get("scene"), { address: "replace" });
      } catch (error) {
        await standIn(newest);
        throw error;
      }
    } else if (newest) await open(newest, { address: "replace" });
    else show();
  } catch (error) {
    failed(error);
  }
}

/** Where nothing is on show, the newest scene, for which the address did not ask; or that there is none. */
async function standIn(newest) {
  if (scene !== null) return;
  if (newest === null) show();
  else await open(newest, { address: null }).catch(failed);
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
  const key = $("key").value;
  const odd = [...key].findIndex((character) => !/^[ -~]$/.test(character));
  if (odd >= 0) { // no header can hold most of these, and no key of a service has any
    const detail = `character ${odd + 1} of ${[...key].length} is not printable ASCII, of which keys consist`;
    return tell($("key-problem"), { title: "Key", detail, cure: "copy it anew, or type it: editors of text change quotation marks and dashes" });
  }
  tell($("key-problem"), null);
  setKey(key);
  $("key-form").hidden = true;
  unlocked();
});
document.addEventListener("key-needed", () => {
  if (!$("key-form").hidden) return;
  $("key-form").hidden = false;
  $("key").focus();
});
$("to-making").addEventListener("click", (event) => {
  event.preventDefault(); // which would be a step of the history
  $("making").scrollIntoView();
  $("files").focus({ preventScroll: true });
});
window.addEventListener("popstate", begin);

prepareMaking(made);
prepareShelf({ open: (id) => open(id).catch(failed), removed, failed });
await awaitReady();
await prepareStage();
await unlocked();
$("main").setAttribute("aria-busy", "false");
