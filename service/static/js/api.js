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

/** An id as it may stand in a path: whatever else an address holds could lead to another one. Throws `Refused`. */
export function checkedId(text, what) {
  if (/^[0-9a-f]{32}$/.test(text)) return text;
  const detail = `${JSON.stringify(text.slice(0, 64))} is no id: need 32 hex digits`;
  throw new Refused({ title: `${what} not found`, detail, cure: "is the link whole?" });
}

/** What `reading` gives; `Refused` where the line breaks meanwhile, or what came is not what a service sends. */
async function whole(reading, detail, cure) {
  try {
    return await reading();
  } catch (error) {
    if (!(error instanceof TypeError || error instanceof SyntaxError)) throw error;
    throw new Refused({ title: "Unreachable", detail, cure });
  }
}

const read = (reading) => whole(reading, "the answer of the service broke off", "try it again");

/** A response that is well; otherwise `Refused`. */
export async function ask(path, { method = "GET", headers = {}, body, signal } = {}) {
  const key = sessionStorage.getItem(KEY);
  const sent = { method, body, signal, headers: key ? { ...headers, "X-API-Key": key } : headers };
  const response = await whole(() => fetch(path, sent), "the service does not answer", "is it running?");
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

export async function askJson(path, options) {
  const response = await ask(path, options);
  return read(() => response.json());
}

export async function askBlob(path, options) {
  const response = await ask(path, options);
  return read(() => response.blob());
}

/** What a path gives, as the address of a picture; the caller revokes it. */
export const askPicture = async (path, options) => URL.createObjectURL(await askBlob(path, options));

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
