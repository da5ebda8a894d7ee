// The options of a new scene: form fields, and a summary of those that are set.

import { $ } from "./dom.js";

const SET = {
  near: (value) => `near ${value}`,
  far: (value) => `far ${value}`,
  max_error: (value) => `colours changed by up to ${value}`,
  opacity: (value) => `${value} opacity`,
  scales: (value) => `${value} scales`,
  rotation: (value) => `rotation ${value}`,
  axes: (value) => `axes ${value}`,
  drop_invalid: () => "without unreadable rows",
  detail: () => "sharper",
  trust_poses: () => "poses trusted",
  refine_poses: () => "poses corrected",
};

/** Value of a field, empty if it is not set. */
function valueOf(name) {
  const field = $(name);
  if (field.type === "checkbox") return field.checked ? field.value : "";
  return field.value.trim();
}

/** Add the fields that are set to a form. */
export function fill(data, names) {
  for (const name of names) if (valueOf(name)) data.set(name, valueOf(name));
  return data;
}

/** List the fields that are set beside the word "Options". */
export function tellSet() {
  const set = Object.entries(SET).filter(([name]) => valueOf(name)).map(([name, words]) => words(valueOf(name)));
  if (!$("model-row").hidden && $("model").selectedIndex > 0) set.push(`network ${$("model").value}`);
  $("set").textContent = set.length ? `: ${set.join(", ")}` : "";
}

/** Reset all fields but the network. */
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
