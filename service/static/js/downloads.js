// Links that download a file of a scene: the page tells a refusal, and what the file's format could not hold.

import { ask, hasKey, read } from "./api.js";
import { make, tell } from "./dom.js";

/** Let the browser download what is at an address. */
const save = (href, download) => make("a", { href, download }).click();

/** Download a file with the API key if there is one; returns what its format could not hold. Throws `Refused`. A .ply,
 * which may be large, is only asked for first where the browser can bring it itself. */
async function bring(path, name) {
  if (path.endsWith(".ply") && !path.endsWith(".compressed.ply") && !hasKey()) {
    await ask(path, { headers: { Range: "bytes=0-0" } });
    save(path, name);
    return [];
  }
  const response = await ask(path);
  const address = URL.createObjectURL(await read(() => response.blob()));
  save(address, name);
  setTimeout(() => URL.revokeObjectURL(address), 60000);
  return JSON.parse(response.headers.get("X-Gapmes-Notes") ?? "[]");
}

/** A link that downloads the file at `path` as `name`, and says in `told` why that is refused, or what is lost in it. */
export function downloading(path, name, text, told) {
  const link = make("a", { href: path, download: name }, text);
  link.addEventListener("click", async (event) => {
    event.preventDefault();
    if (link.hasAttribute("aria-busy")) return;
    link.setAttribute("aria-busy", "true");
    told.replaceChildren();
    try {
      const notes = await bring(path, name);
      if (notes.length) told.append(make("p", { class: "warning" }, make("strong", {}, `${text}: `), notes.join("; ")));
    } catch (error) {
      const problem = make("div", { class: "problem" });
      tell(problem, error);
      told.append(problem);
    } finally {
      link.removeAttribute("aria-busy");
    }
  });
  return link;
}
