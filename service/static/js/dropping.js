// Files that are dropped on the page.

import { $, tell } from "./dom.js";

/** Call `take(files)` for files that are dropped anywhere; nothing that is dropped leaves the page. */
export function prepareDropping(take) {
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      $("drop").classList.toggle("over", event.dataTransfer.types.includes("Files"));
    });
  }
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && $("drop").classList.remove("over"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    $("drop").classList.remove("over");
    const { files, items } = event.dataTransfer;
    const folder = [...items].map((item) => item.webkitGetAsEntry?.()).find((entry) => entry?.isDirectory);
    if (folder) tell($("problem"), { title: "A folder", detail: `${folder.name} is a folder`, cure: "drop its photographs with the camera file, or one zip of it" });
    else if (files.length) take([...files]);
    else tell($("problem"), { title: "No file", detail: "what was dropped is not a file", cure: "save it as a file, and drop that" });
  });
}
