// Cures and warnings in the words of the page, where those of the service are for API clients or operators.

const CAMERA_FILES = "choose a camera file: cameras.json, transforms.json, poses_bounds.npy, a RealEstate10K .txt or a zip of a COLMAP model";

const CURES = {
  unauthorized: "type the key at the top of the page",
  scene_not_found: "choose another one from the list",
  upload_too_large: "send smaller photographs, or fewer",
  view_count: "choose 2 to 6 photographs, or one zip of a capture with its cameras",
  format_invalid: "write the file again without the Gaussians that the message names",
  deadline_exceeded: "use fewer photographs",
  storage_full: "delete scenes from the list",
  model_not_ready: "try again once the top of the page names the network",
  host_refused: "open the page by the service's own name",
  origin_refused: "ask whoever runs the service: a proxy in front of it must pass on the Host header",
};
const PHRASES = [ // replaced within a cure
  [/^ask for it again$/, "reconstruct it again"],
  [/set trust_poses/, 'tick "Only warn if …" under Options'],
  [/set refine_poses/, 'tick "Correct poses …" under Options'],
  [/, as refine_poses could not altogether/, ", which could not be done altogether here"],
  [/(\. Or|, or) raise GAPMES_\w+/, ""],
  [/^is the upload complete\?$/, "the file is damaged: copy it once more from where it comes from"],
  [/^leave it out, or name the file as its view .*/, "leave it out, or give it the name that the camera file has for it"],
  [/^send cameras\.json, .*/, CAMERA_FILES],
  [/^send one camera per image, or name .*/, "choose the photographs to which the camera file belongs, under the names that they have there"],
];
const OF_REQUESTS = /`|\b(GET|POST) \/|\/readyz|Bearer|\bcurl |--[a-z]|GAPMES_|\b(over HTTP|trust_poses|refine_poses|drop_invalid)\b/;
const OF_CAMERAS = /^(cameras|views|frames)\b/;

const inPageWords = (text) => PHRASES.reduce((words, [theirs, ours]) => words.replace(theirs, ours), text);

/** A warning in the page's own words, with its view unless it names views by itself. */
export function warned({ index, message }) {
  const ofView = index == null || /\b(view|photographs) \d/.test(message) ? "" : `view ${index}: `;
  return ofView + inPageWords(message);
}

/** The cure of a problem document in the page's own words; undefined where there is none. */
export function cureOf({ code, field, cure }) {
  if (!cure) return cure;
  const words = inPageWords(cure);
  if (!OF_REQUESTS.test(words)) return words;
  return CURES[code] ?? (OF_CAMERAS.test(field) ? CAMERA_FILES : undefined);
}
