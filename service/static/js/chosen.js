// The files of a new scene that were dropped or chosen: what each of them is, their list, and how one is taken out.

import { $, button, counted, make } from "./dom.js";

const KINDS = {
  gaussians: /\.(ply|splat|spz)$/i,
  zip: /\.zip$/i,
  cameras: /\.(json|npy|txt)$/i,
  photograph: /\.(jpe?g|png|webp)$|^[^.]+$/i, // its content counts: what has no ending may be one
};
const PHOTOGRAPHS = ["image/jpeg", "image/png", "image/webp"]; // by other endings
const STRAYS = [ // what helps, of files that are none of these
  [/\.bin$/i, "where it is of a COLMAP model, choose one zip of its folder"],
  [/\.(heic|heif|avif|tiff?|gif|bmp|dng|cr[23]|nef|arw)$/i, "convert it to JPEG, PNG or WebP"],
];
const FEW = 12; // files whose list is open from the start

let files = [];
let changed = () => {}; // called when one was taken out

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

/** Files in addition to those that are there; one of the same name takes its place, which is said of photographs. */
export function add(more) {
  const fresh = more.filter((file, place) => !more.slice(0, place).some((other) => same(file, other)));
  const anew = (file) => fresh.filter(({ name }) => name === file.name);
  const replaced = images().filter((file) => anew(file).length && !anew(file).some((other) => same(file, other)));
  files = [...new Set([...files.flatMap((file) => (anew(file).length ? anew(file) : [file])), ...fresh])];
  show();
  $("replaced").hidden = replaced.length === 0;
  if (replaced.length === 0) return;
  const which = replaced.slice(0, 4).map(({ name }) => name).join(", ") + (replaced.length > 4 ? ", …" : "");
  const words = replaced.length === 1 ? "takes the place of another file of that name" : "take the places of other files of these names";
  $("replaced").replaceChildren(make("strong", {}, "Note: "), `${which} ${words}. Where both are wanted, give them names of their own.`);
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

/** In the chooser, which tells the number or the name. */
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
    $("so-far").append(`, ${passedOver.length} of them passed over`);
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
  }, { class: "quiet", "aria-label": `Take out ${file.name}` });
  const cure = STRAYS.find(([pattern]) => pattern.test(file.name))?.[1];
  const why = stray ? make("span", { class: "why" }, ` passed over${cure ? `: ${cure}` : ""} `) : " ";
  return make("li", {}, file.name, why, out);
}
