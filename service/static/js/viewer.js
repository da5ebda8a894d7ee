// The frame that holds the WebGL viewer: it fetches the scene, with the key where there is one, and tells the page when it drew.

import { createViewer } from "/static/viewer/index.js";
import { ask, askJson } from "./api.js";

const tellPage = (message) => parent.postMessage(message, location.origin);
const id = encodeURIComponent(new URLSearchParams(location.search).get("scene") ?? "");

let drawn = false;

function failed(reason) {
  if (!drawn) tellPage({ viewer: "failed", reason }); // afterwards a fault need not end what is on show
}

window.firstFrame = () => {
  drawn = true;
  tellPage({ viewer: "drawn" });
};
window.addEventListener("error", (event) => failed(event.message));
window.addEventListener("unhandledrejection", (event) => failed(String(event.reason?.message ?? event.reason)));
document.addEventListener("webglcontextlost", () => tellPage({ viewer: "failed", reason: "the graphics card gave up" }), true);

try {
  const contentUrl = `/scenes/${id}/viewer.ply`;
  const [settings, contents] = await Promise.all([askJson(`/scenes/${id}/viewer.json`), ask(contentUrl)]);
  await createViewer({
    container: document.body,
    settings,
    contentUrl,
    contents: Promise.resolve(contents),
    renderer: "webgl",
    noanim: true,
    ui: false,
    exposeGlobals: true,
  });
} catch (error) {
  failed(error.message);
}
