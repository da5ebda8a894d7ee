// The frame that holds the WebGL viewer: it fetches the scene, with the key where there is one, and tells the page when it drew.

import { createViewer } from "/static/viewer/index.js";
import { ask } from "./api.js";

const tellPage = (message) => parent.postMessage(message, location.origin);
const id = encodeURIComponent(new URLSearchParams(location.search).get("scene") ?? "");

window.firstFrame = () => tellPage({ viewer: "drawn" });
window.addEventListener("error", (event) => tellPage({ viewer: "failed", reason: event.message }));
window.addEventListener("unhandledrejection", (event) => tellPage({ viewer: "failed", reason: String(event.reason) }));

try {
  const contentUrl = `/scenes/${id}/viewer.ply`;
  const settings = await (await ask(`/scenes/${id}/viewer.json`)).json();
  await createViewer({
    container: document.body,
    settings,
    contentUrl,
    contents: ask(contentUrl),
    renderer: "webgl",
    noanim: true,
    ui: false,
    exposeGlobals: true,
  });
} catch (error) {
  tellPage({ viewer: "failed", reason: error.message });
}
