// What is wrong with the chosen files: checks by the page itself, and names for what the service refuses.

import { all, cameras, gaussians, images, strays, zips } from "./chosen.js";
import { $, counted } from "./dom.js";

export const MOST = 6; // photographs of a scene
const MOST_SENT = 60;  // photographs that may be sent one by one
const TAKEN = "JPEG, PNG or WebP photographs, a camera file, a zip of both, or a file of Gaussians";

const names = (files) => files.slice(0, 4).map(({ name }) => name).join(", ") + (files.length > 4 ? ", …" : "");

/** A sentence about missing files, null if none is missing. */
export function missing() {
  const count = images().length;
  if (zips().length && !count) return null;
  if (!cameras().length && !zips().length) {
    return `${counted(count, "photograph")}. Add their camera file: cameras.json, transforms.json, poses_bounds.npy or a RealEstate10K .txt, or a zip of a COLMAP model. If there is none, the program COLMAP computes it, from eight photographs or more: choose one zip of its project folder.`;
  }
  if (count > MOST && !$("context").value) return `${counted(all().length, "file")}. Choose how many photographs to use.`;
  if (count < 2) return `${counted(count, "photograph")} so far. Add ${count ? "1" : "2"} or more, of 2 to ${MOST} photographs.`;
  return null;
}

/** A problem document about files that cannot be sent, null if all can. */
export function impossible() {
  const count = images().length;
  if (gaussians().length && count) {
    return { title: "Two kinds of files", detail: `${counted(count, "photograph")} beside ${gaussians()[0].name}, which is a scene already`, cure: "start over with one kind of file" };
  }
  if (gaussians().length > 1) {
    return { title: "Files of Gaussians", detail: `${gaussians().length} at once, need one: ${names(gaussians())}`, cure: "remove the others, and load the files one at a time" };
  }
  const those = [...cameras(), ...zips()];
  if (those.length > 1) {
    const beside = count ? " beside the photographs" : gaussians().length ? ` beside ${gaussians()[0].name}` : "";
    const cure = zips().length && !count ? "remove the others; the cameras of a zip belong inside it" : "remove the others; add a COLMAP model of several files as one zip";
    return { title: "Camera files", detail: `${those.length}${beside}, need one: ${names(those)}`, cure };
  }
  if (strays().length === all().length) return { title: "Files", detail: `${names(strays())}: none can be used`, cure: `choose ${TAKEN}` };
  if (count <= MOST_SENT) return null;
  return { title: "View count", detail: `${count} photographs, at most ${MOST_SENT} outside a zip`, cure: "send them as one zip with their camera file: the best few are then chosen" };
}

/** With the name of the photograph instead of its place among them, or the words beside an option. */
export function withName(error) {
  const { field, index } = error.problem ?? {};
  const photograph = field === "images" ? images()[index] : null;
  const option = $("options").querySelector(`input[name="${field}"]`);
  const name = photograph?.name ?? option?.labels[0].textContent.trim();
  return name ? { ...error.problem, name } : error;
}
