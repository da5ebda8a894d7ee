// The chosen or dropped files of a new scene: their kinds, their list, and removing one.

import { $, button, counted, make } from "./dom.js";

const KINDS = {
  gaussians: /\.(ply|splat|spz)$/i,
  zip: /\.zip$/i,
  cameras: /\.(json|npy|txt)$/i,
  photograph: /\.(jpe?g|png|webp)$|^[^.]+$/i, // without a suffix it may be one; the service decides by content
};
const PHOTOGRAPHS = ["image/jpeg", "image/png", "image/webp"]; // of files with other suffixes
const STRAYS = [ // cures for other files
  [/\.bin$/i, "if it belongs to a COLMAP model, choose one zip of its folder"],
  [/\.(heic|heif|avif|tiff?|gif|bmp|dng|cr[23]|nef|arw)$/i, "convert it to JPEG, PNG or WebP"],
];
const FEW = 12; // lists of up to so many files are open at first

let files = [];
let changed = () => {}; // called when a file was removed

export const prepareChosen = (act) => { changed = act; };

function kindOf({ name, type }) {
  const kind = Object.keys(KINDS).find((one) => KINDS[one].test(name));
  return kind ?? (PHOTOGRAPHS.includes(type) ? "photograph" : "stray");
}

const of = (kind) => files.filter((file) => kindOf(file) === kind);

export const all = () => files;
export const gaussians = () => of("gaussians");
export const zips = () => of("zip");
export const cameras = () => of("cameras");
export const images = () => of("photograph");
export const strays = () => of("stray");
export const isCameras = (file) => kindOf(file) === "cameras";

const same = (one, other) => one.name === other.name && one.size === other.size && one.lastModified === other.lastModified;

/** Add files; one replaces another of the same name, with a note for photographs. */
export function add(more) {
  const fresh = more.filter((file, place) => !more.slice(0, place).some((other) => same(file, other)));
  const anew = (file) => fresh.filter(({ name }) => name === file.name);
  const replaced = images().filter((file) => anew(file).length && !anew(file).some((other) => same(file, other)));
  files = [...new Set([...files.flatMap((file) => (anew(file).length ? anew(file) : [file])), ...fresh])];
  show();
  $("replaced").hidden = replaced.length === 0;
  if (replaced.length === 0) return;
  const which = replaced.slice(0, 4).map(({ name }) => name).join(", ") + (replaced.length > 4 ? ", …" : "");
  const words = replaced.length === 1 ? "replaces another file of that name" : "replace other files of these names";
  $("replaced").replaceChildren(make("strong", {}, "Note: "), `${which} ${words}. To keep both, give them different names.`);
}

export function takeOut(file) {
  files = files.filter((one) => one !== file);
  $("replaced").hidden = true;
  show();
}

export function takeAllOut() {
  files = [];
  $("replaced").hidden = true;
  show();
}

/** Put the files into the file input, which shows their number or name. */
export function fillChooser() {
  const holder = new DataTransfer();
  for (const file of files) holder.items.add(file);
  $("files").files = holder.files;
}

function show() {
  fillChooser();
  if ($("chosen").hidden) $("chosen").open = files.length <= FEW;
  $("chosen").hidden = files.length === 0;
  $("so-far").textContent = counted(files.length, "file");
  const passedOver = strays();
  if (passedOver.length) {
    $("so-far").append(`, ${passedOver.length} of them ignored`);
    $("chosen").open = true;
  }
  $("chosen-files").replaceChildren(...files.map((file) => row(file, passedOver.includes(file))));
}

function row(file, stray) {
  const out = button("×", () => {
    const place = files.indexOf(file);
    takeOut(file);
    const next = $("chosen-files").children[Math.min(place, files.length - 1)];
    (next?.querySelector("button") ?? $("files")).focus();
    changed();
  }, { class: "quiet", "aria-label": `Remove ${file.name}` });
  const cure = STRAYS.find(([pattern]) => pattern.test(file.name))?.[1];
  const why = stray ? make("span", { class: "why" }, ` ignored${cure ? `: ${cure}` : ""} `) : " ";
  return make("li", {}, file.name, why, out);
}
