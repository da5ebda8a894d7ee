// Everything that is asked of the service: with the key where there is one, and with its problem documents as errors.

const KEY = "gapmes-key";

/** A refusal: what the service said, or that it said nothing. */
export class Refused extends Error {
  constructor(problem, status = 0) {
    super(problem.detail);
    this.problem = problem;
    this.status = status;
  }
}

export const setKey = (key) => sessionStorage.setItem(KEY, key);

const hasKey = () => sessionStorage.getItem(KEY) !== null;

/** A response that is well; otherwise `Refused`. */
export async function ask(path, { method = "GET", headers = {}, body, signal } = {}) {
  const key = sessionStorage.getItem(KEY);
  let response;
  try {
    response = await fetch(path, { method, body, signal, headers: key ? { ...headers, "X-API-Key": key } : headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refused({ title: "Unreachable", detail: "the service does not answer", cure: "is it running?" });
  }
  if (response.ok) return response;
  let problem;
  try {
    problem = await response.json();
  } catch {
    problem = { title: "Error", detail: `the service answered ${response.status}` };
  }
  if (response.status === 401) document.dispatchEvent(new Event("key-needed"));
  throw new Refused(problem, response.status);
}

export const askJson = async (path, options) => (await ask(path, options)).json();

/** What a path gives, as the address of a picture; the caller revokes it. */
export const askPicture = async (path, options) => URL.createObjectURL(await (await ask(path, options)).blob());

/** Put what a path gives into an image, and let go of what it showed. */
export async function showPicture(image, path) {
  const address = await askPicture(path);
  if (image.src.startsWith("blob:")) URL.revokeObjectURL(image.src);
  image.src = address;
  if (!image.isConnected) URL.revokeObjectURL(address); // it was taken away meanwhile
}

/** Server-sent events of a path, one after the other, as {id, event, data}. */
export async function* events(path, signal) {
  const reader = (await ask(path, { signal })).body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const fields = Object.fromEntries(block.split("\n").filter((line) => !line.startsWith(":")).map((line) => {
        const colon = line.indexOf(":");
        return [line.slice(0, colon), line.slice(colon + 1).trimStart()];
      }));
      if (fields.data) yield { id: fields.id, event: fields.event, data: JSON.parse(fields.data) };
    }
  }
}

/** A link that brings a file, also where a key must go with it; `failed` hears why it could not. */
export function bring(link, failed) {
  link.addEventListener("click", async (event) => {
    if (!hasKey() || link.href.startsWith("blob:")) return;
    event.preventDefault();
    try {
      const address = await askPicture(link.getAttribute("href"));
      const copy = document.createElement("a");
      copy.href = address;
      copy.download = link.download;
      copy.click();
      setTimeout(() => URL.revokeObjectURL(address), 60000);
    } catch (error) {
      failed(error);
    }
  });
  return link;
}
