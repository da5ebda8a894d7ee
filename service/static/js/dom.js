// Helpers for the document: finding and creating elements, showing problems, formatting numbers.

import { cureOf } from "./cures.js";

export const $ = (id) => document.getElementById(id);

/** Create an element with attributes and children; strings become text nodes, never HTML. */
export function make(tag, attributes = {}, ...children) {
  const node = tag.startsWith("svg:")
    ? document.createElementNS("http://www.w3.org/2000/svg", tag.slice(4))
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined && value !== null) node.setAttribute(name, value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

export function button(text, act, attributes = {}) {
  const node = make("button", { type: "button", ...attributes }, text);
  node.addEventListener("click", act);
  return node;
}

/** Show a problem document, or an error with one, in `target`; null clears it. */
export function tell(target, said) {
  const problem = said instanceof Error ? said.problem ?? { title: "Error", detail: said.message } : said;
  target.replaceChildren();
  if (!problem) return;
  const at = problem.index === undefined ? "" : ` ${problem.index}`;
  const named = problem.name ?? (problem.field && `${problem.field}${at}`);
  const where = named ? ` (${named})` : "";
  target.append(make("strong", {}, `${problem.title}${where}: `), problem.detail || "");
  const cure = cureOf(problem);
  if (cure) target.append(make("br"), `What helps: ${cure}`);
}

const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442", "#999999"];

/** Colour of an index: the eight colours of Okabe and Ito, safe for colour-blind viewers, repeated. */
export const colourOf = (kind) => COLOURS[kind % COLOURS.length];

/** A small square of a colour, for legends. */
export function swatch(colour) {
  const svg = make("svg:svg", { viewBox: "0 0 12 12", width: 12, height: 12, "aria-hidden": "true" });
  svg.append(make("svg:rect", { width: 12, height: 12, rx: 3, fill: colour }));
  return svg;
}

/** Empty an element, and revoke the object URLs of its images and links. */
export function discard(target) {
  for (const node of target.querySelectorAll("img[src^='blob:'], a[href^='blob:']")) URL.revokeObjectURL(node.src ?? node.href);
  target.replaceChildren();
}

/** Three significant digits, whatever the units. */
export const digits = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(3))) : "–");

export const count = (value) => value.toLocaleString("en");

/** "1 file", "2 files". */
export const counted = (value, what) => `${count(value)} ${what}${value === 1 ? "" : "s"}`;

export const percent = (share) => (typeof share === "number" ? `${digits(100 * share)} %` : "–");
