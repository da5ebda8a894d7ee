// Small helpers around the document: find, make, tell.

export const $ = (id) => document.getElementById(id);

/** An element with attributes and children; texts become text nodes, so that nothing is ever read as HTML. */
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

/** Show a problem document in a place for it, or nothing. */
export function tell(target, problem) {
  target.replaceChildren();
  if (!problem) return;
  const at = problem.index === undefined ? "" : ` ${problem.index}`;
  const where = problem.field ? ` (${problem.field}${at})` : "";
  target.append(make("strong", {}, `${problem.title}${where}: `), problem.detail || "");
  if (problem.cure) target.append(make("br"), `What helps: ${problem.cure}`);
}

/** Three significant digits, whatever the units. */
export const digits = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(3))) : "–");

export const count = (value) => value.toLocaleString("en");

export const percent = (share) => `${digits(100 * share)} %`;
