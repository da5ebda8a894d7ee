// What helps whoever looks at the page, where the service's own words are for those who write requests or run it.

const CAMERA_FILES = "is it the right file? Cameras come as cameras.json, transforms.json, poses_bounds.npy, a RealEstate10K .txt or a zip of a COLMAP model";

const CURES = {
  unauthorized: "type the key at the top of the page",
  scene_not_found: "choose another one from the list",
  upload_too_large: "send smaller photographs, or fewer",
  view_count: "choose 2 to 6 photographs, or one zip of a capture with its cameras",
  format_invalid: "write the file anew without the Gaussians that it tells of",
  deadline_exceeded: "use fewer photographs",
  storage_full: "delete scenes of the list",
  model_not_ready: "try again once the top of the page names the network",
  origin_refused: "whoever runs the service: a proxy before it must pass on its Host",
};
const PHRASES = [ // within a cure of several
  [/set trust_poses/, 'tick "Only warn where …" under Options'],
  [/(\. Or|, or) raise GAPMES_\w+/, ""],
];
const OF_REQUESTS = /`|\b(GET|POST) \/|\/readyz|Bearer|\bcurl |--[a-z]|GAPMES_|\b(over HTTP|trust_poses|drop_invalid)\b/;
const OF_CAMERAS = /^(cameras|views|frames)\b/;

/** The cure of a problem document in the page's own words; undefined where there is none. */
export function cureOf({ code, field, cure }) {
  if (!cure) return cure;
  const words = PHRASES.reduce((text, [theirs, ours]) => text.replace(theirs, ours), cure);
  if (!OF_REQUESTS.test(words)) return words;
  return CURES[code] ?? (OF_CAMERAS.test(field) ? CAMERA_FILES : undefined);
}
