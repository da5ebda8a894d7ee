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
async function read(reading) {
  try {
    return await reading();
  } catch (error) {
    if (!(error instanceof TypeError || error instanceof SyntaxError)) throw error;
    throw new Refused({ title: "Unreachable", detail: "the answer of the service broke off", cure: "try it again" });
  }
}

/** Whether the beginning of a file can be read; a slice of one that is gone is empty, which can. */
async function readable(file) {
  const reader = file.stream().getReader();
  try {
    await reader.read();
    return true;
  } catch {
    return false;
  } finally {
    reader.cancel().catch(() => undefined);
  }
}

/** Why nothing answered: where a file of what was sent can no longer be read, browsers tell just that too. */
async function silence(body) {
  for (const file of body instanceof FormData ? body.values() : []) {
    if (file instanceof File && !(await readable(file))) {
      const detail = `${file.name} can no longer be read: it was changed, moved or deleted since it was chosen`;
      return { title: "File unreadable", detail, cure: "choose it again" };
    }
  }
  return { title: "Unreachable", detail: "the service does not answer", cure: "is it running?" };
}

/** A response that is well; otherwise `Refused`. */
export async function ask(path, { method = "GET", headers = {}, body, signal } = {}) {
  const key = sessionStorage.getItem(KEY);
  const sent = { method, body, signal, headers: key ? { ...headers, "X-API-Key": key } : headers };
  let response;
  try {
    response = await fetch(path, sent);
  } catch (error) {
    if (!(error instanceof TypeError)) throw error;
    throw new Refused(await silence(body));
  }
  if (response.ok) return response;
  let problem = await response.json().catch(() => null);
  if (typeof problem?.title !== "string") problem = { title: "Error", detail: `the service answered ${response.status}` }; // not its own words
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
