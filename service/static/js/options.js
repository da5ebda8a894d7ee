// The options of a new scene: what goes into a request, and what is set, which is told where they are folded away.

import { $ } from "./dom.js";

const SET = {
  near: (value) => `near ${value}`,
  far: (value) => `far ${value}`,
  max_error: (value) => `colours changed by up to ${value}`,
  opacity: (value) => `${value} opacity`,
  scales: (value) => `${value} scales`,
  rotation: (value) => `rotation ${value}`,
  axes: (value) => `axes ${value}`,
  drop_invalid: () => "without what cannot be read",
  detail: () => "sharper",
  trust_poses: () => "poses are trusted",
};

/** What is filled in, chosen or ticked; empty where nothing is. */
function valueOf(name) {
  const field = $(name);
  if (field.type === "checkbox") return field.checked ? field.value : "";
  return field.value.trim();
}

/** Fields that are set go into a form. */
export function fill(data, names) {
  for (const name of names) if (valueOf(name)) data.set(name, valueOf(name));
  return data;
}

/** Tell what is set beside the word "Options". */
export function tellSet() {
  const set = Object.entries(SET).filter(([name]) => valueOf(name)).map(([name, words]) => words(valueOf(name)));
  if (!$("model-row").hidden && $("model").selectedIndex > 0) set.push(`network ${$("model").value}`);
  $("set").textContent = set.length ? `: ${set.join(", ")}` : "";
}

/** As at the beginning, but for the network. */
export function unset() {
  for (const name of Object.keys(SET)) {
    if ($(name).type === "checkbox") $(name).checked = false;
    else $(name).value = "";
  }
  tellSet();
}

export function prepareOptions() {
  $("options").addEventListener("input", tellSet);
  tellSet(); // browsers remember what was filled in
}
