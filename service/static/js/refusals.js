// Checks by the page itself: chosen files that cannot be sent, and files that are missing.

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
    return `${counted(count, "photograph")}. Add their camera file: cameras.json, transforms.json, poses_bounds.npy or a RealEstate10K .txt, or a zip of a COLMAP model.`;
  }
  if (count > MOST && !$("context").value) return `${counted(all().length, "file")}. Choose how many photographs to use.`;
  return count < 2 ? `${count} of 2 to ${MOST} photographs.` : null;
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
  if ((count || gaussians().length) && those.length > 1) {
    const beside = count ? "the photographs" : gaussians()[0].name;
    return { title: "Camera files", detail: `${those.length} beside ${beside}, need one: ${names(those)}`, cure: "remove the others; add a COLMAP model of several files as one zip" };
  }
  if (strays().length === all().length) return { title: "Files", detail: `${names(strays())}: none can be used`, cure: `choose ${TAKEN}` };
  if (count <= MOST_SENT) return null;
  return { title: "View count", detail: `${count} photographs, at most ${MOST_SENT} outside a zip`, cure: "send them as one zip with their camera file: the best few are then chosen" };
}
