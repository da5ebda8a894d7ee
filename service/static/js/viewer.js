// The document of the WebGL viewer's frame: it fetches the scene, with the API key if there is one, and reports
// progress and the first picture to the page.

import { createViewer } from "/static/viewer/index.js";
import { ask, askJson } from "./api.js";

const SIGN_MS = 200; // between progress messages

const scene = new URLSearchParams(location.search).get("scene") ?? "";
const tellPage = (message) => parent.postMessage({ ...message, scene }, location.origin);

let drawn = false;

function failed(reason) {
  if (!drawn) tellPage({ viewer: "failed", reason }); // later errors need not affect what is shown
}

window.firstFrame = () => {
  drawn = true;
  tellPage({ viewer: "drawn" });
};
window.addEventListener("error", (event) => failed(event.message));
window.addEventListener("unhandledrejection", (event) => failed(String(event.reason?.message ?? event.reason)));
for (const name of ["dragenter", "dragover"]) document.addEventListener(name, () => tellPage({ viewer: "carried" }));
document.addEventListener("webglcontextlost", () => tellPage({ viewer: "failed", reason: "the WebGL context was lost" }), true);

/** The response, with progress messages to the page while it is read. */
function counted(response) {
  const all = Number(response.headers.get("Content-Length"));
  let came = 0;
  let last = -SIGN_MS;
  const counting = new TransformStream({
    transform(piece, controller) {
      came += piece.byteLength;
      controller.enqueue(piece);
      if (performance.now() - last < SIGN_MS && came !== all) return;
      last = performance.now();
      tellPage({ viewer: "came", came, all });
    },
  });
  return new Response(response.body.pipeThrough(counting), response);
}

try {
  const id = encodeURIComponent(scene);
  const contentUrl = `/scenes/${id}/viewer.ply`;
  const [settings, contents] = await Promise.all([askJson(`/scenes/${id}/viewer.json`), ask(contentUrl)]);
  await createViewer({
    container: document.body,
    settings,
    contentUrl,
    contents: Promise.resolve(counted(contents)),
    renderer: "webgl",
    noanim: true,
    ui: false,
    exposeGlobals: true,
  });
} catch (error) {
  failed(error.message);
}
