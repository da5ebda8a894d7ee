// Entry point of the page: what its URL asks for, and the connections between the parts.

import { addressOf, instead, named, step } from "./address.js";
import { askJson, checkedId, Refused, setKey } from "./api.js";
import { showAbout } from "./about.js";
import { $, button, tell } from "./dom.js";
import { following } from "./job.js";
import { attend, busy, checkAgain, prepareMaking, prepareModels } from "./making.js";
import { first, ids, markChosen, prepareShelf, refreshShelf, remove } from "./shelf.js";
import { prepareStage, showScene } from "./stage.js";

let scene = null;
let coming = null; // the id of the scene that is opened, on show, or not there
let offered = null; // the id of a scene that is ready while another one is on show
let turn = 0; // number of the latest opening; late answers to earlier ones are ignored

const failed = (error, place) => {
  if (!(error instanceof Refused)) throw error;
  tell(place ?? $("view-problem"), error);
};

/** Show a scene; its `address`, with the job that runs, becomes a step to come back from, takes the place of the last one, or (null) is not told. Throws `Refused`. */
async function open(id, { address = "push" } = {}) {
  const mine = (turn += 1);
  coming = id;
  let found = null;
  try {
    found = await askJson(`/scenes/${checkedId(id, "Scene")}`);
  } catch (error) {
    if (mine !== turn) return;
    if (error.status !== 404) coming = scene?.id ?? null;
    throw error;
  }
  if (mine !== turn) return;
  scene = found;
  const own = addressOf(id, following());
  if (address === "push" && location.search !== own) step(own);
  else if (address !== null) instead(own);
  show();
}

function show() {
  const within = ["views", "about"].some((id) => $(id).contains(document.activeElement)); // which is replaced
  showScene(scene);
  showAbout($("about"), scene);
  if (within) $(scene ? "stage" : "files").focus({ preventScroll: true });
  markChosen(scene?.id ?? null);
  if (scene?.id === offered) offer(null);
}

/** A scene is made or loaded: it is shown, or offered where another one is on show that the user chose meanwhile. Gives where the eye goes. */
async function made(id, address) {
  await refreshShelf();
  if (address === "offer" && scene !== null && scene.id !== id) return offer(id);
  await open(id, { address: address === "replace" ? address : "push" }).catch(failed);
  $("stage").scrollIntoView({ block: "nearest" });
  return $("stage");
}

function offer(id) {
  offered = id;
  const way = button("Show it", async () => {
    await open(id).catch(failed);
    $("stage").focus();
  });
  $("offer").replaceChildren(...(id === null ? [] : ["The new scene is ready. ", way]));
  return way;
}

async function removed(id) {
  if (id === offered) offer(null);
  if (![coming, scene?.id].includes(id)) return;
  const tried = new Set();
  let fault = null;
  for (let next = first(); next; next = ids().find((one) => !tried.has(one))) {
    try {
      return await open(next, { address: "replace" });
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      fault = error;
      if (![404, 422].includes(error.status)) break; // deleted elsewhere, or damaged: the one after it
    }
    tried.add(next);
    const mine = turn;
    await refreshShelf();
    if (mine !== turn) return; // another one was opened meanwhile
  }
  turn += 1; // nor is any to come
  scene = coming = null;
  instead(addressOf(null, following()));
  if (document.activeElement === $("remove")) $("files").focus(); // the button goes
  show();
  if (!fault) return;
  $("empty").hidden = true; // there are scenes, or that is not known
  failed(fault);
}

/** Wait while the service starts; with any other failure the page continues. */
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

/** Do what the URL asks for: follow a job, show a scene, or the newest one. */
async function begin() {
  const [job, asked] = [named("job"), named("scene")];
  tell($("view-problem"), null);
  try {
    const newest = first() ?? (await refreshShelf()); // the list stays as it is at a step of the history
    let fault = null;
    if (asked !== null) {
      await open(asked, { address: null }).catch((error) => { fault = error; });
      if (fault) await standIn(newest);
    } else if (job !== null) await standIn(newest);
    else if (newest) await open(newest, { address: "replace" });
    else if (newest === null) show();
    if (job !== null && !busy()) attend(job); // the page does not wait for it
    if (fault) throw fault;
  } catch (error) {
    failed(error);
  }
}

/** If no scene is shown, show the newest without changing the URL, or that there is none (null); nothing where that is not known. */
async function standIn(newest) {
  if (scene !== null) return;
  if (newest === null) show();
  else if (newest) await open(newest, { address: null }).catch(failed);
}

/** Everything that needs the API key, if there is one. */
async function unlocked() {
  let fault = null;
  await prepareModels().catch((error) => { fault = error; });
  await begin(); // which clears what is told
  if (fault) failed(fault);
  checkAgain();
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
$("remove").addEventListener("click", () => scene && remove(scene.id, $("view-problem")));
$("key-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const key = $("key").value;
  const odd = [...key].findIndex((character) => !/^[ -~]$/.test(character));
  if (odd >= 0) { // no header can hold most of these, and no key of a service has any
    const detail = `character ${odd + 1} of ${[...key].length} is not printable ASCII, and keys contain nothing else`;
    return tell($("key-problem"), { title: "Key", detail, cure: "copy it again, or type it: text editors change quotation marks and dashes" });
  }
  tell($("key-problem"), null);
  setKey(key);
  $("stage").focus({ preventScroll: true }); // the form goes
  $("key-form").hidden = true;
  unlocked();
});
document.addEventListener("key-needed", ({ detail }) => {
  if (!$("key-form").hidden) return;
  if (detail.refused) tell($("key-problem"), { title: "Key", detail: "the service does not take this one", cure: "type it again" });
  $("key-form").hidden = false;
  $("key").focus();
});
$("to-making").addEventListener("click", (event) => {
  event.preventDefault(); // which would be a step of the history
  $("making").scrollIntoView();
  $("files").focus({ preventScroll: true });
});
window.addEventListener("popstate", begin);
let awaited = 0;
document.addEventListener("awaited", ({ detail }) => {
  awaited += detail;
  $("silence").textContent = awaited ? "The service has not answered for 10 seconds; the page goes on waiting." : "";
});

prepareMaking(made);
prepareShelf({ open, removed, failed });
await awaitReady();
await prepareStage();
await unlocked();
$("main").setAttribute("aria-busy", "false");
