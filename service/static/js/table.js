// Tables of the panel: rows, heads, and scrolling of wide ones.

import { make } from "./dom.js";

export const row = (...cells) => make("tr", {}, ...cells.map((cell) => make("td", {}, cell)));
export const head = (...cells) => make("thead", {}, make("tr", {}, ...cells.map((cell) => make("th", { scope: "col" }, cell))));
export const wide = (table) => make("div", { class: "wide" }, table);
export const decibels = (entry) => (entry?.psnr === null || entry?.psnr === undefined ? "–" : `${entry.psnr.toFixed(1)} dB`);
