// Requests to the service, with the API key if there is one; problem documents become errors.

const KEY = "gapmes-key";
const PATIENCE_MS = 10_000;
const AGAIN = "try again in a moment";

/** An error with a problem document, of the service or of the page itself. */
export class Refused extends Error {
  constructor(problem, status = 0) {
    super(problem.detail);
    this.problem = problem;
    this.status = status;
  }
}

export const setKey = (key) => sessionStorage.setItem(KEY, key);

export const hasKey = () => sessionStorage.getItem(KEY) !== null;

/** An id that is safe in a path: any other text of a URL could lead to another path. Throws `Refused`. */
export function checkedId(text, what) {
  if (/^[0-9a-f]{32}$/.test(text)) return text;
  const detail = `${JSON.stringify(text.slice(0, 64))} is not an id: need 32 hex digits`;
  throw new Refused({ title: `${what} not found`, detail, cure: "check that the link is complete" });
}

/** The result of `reading`. Throws `Refused` if the connection breaks or the body is malformed. */
export async function read(reading) {
  try {
    return await reading();
  } catch (error) {
    if (!(error instanceof TypeError || error instanceof SyntaxError)) throw error;
    throw new Refused({ title: "Unreachable", detail: "the response of the service was cut off", cure: "try again" });
  }
}

/** Whether a file can be read, by its stream: a slice of a deleted file would be empty, without an error. */
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

/** The problem behind a failed request: browsers report an unreadable file like an unreachable service. */
async function silence(body) {
  for (const file of body instanceof FormData ? body.values() : []) {
    if (file instanceof File && !(await readable(file))) {
      const detail = `${file.name} can no longer be read: it was changed, moved or deleted since it was chosen`;
      return { title: "File unreadable", detail, cure: "choose it again" };
    }
  }
  return { title: "Unreachable", detail: "the service does not answer", cure: "wait a moment and try again; if that does not help, tell whoever runs the service" };
}

/** Headers with the key, if there is one. */
export function keyed(headers) {
  const key = sessionStorage.getItem(KEY);
  return key ? { ...headers, "X-API-Key": key } : headers;
}

/** The problem of a status without words of the service: a proxy before it has answered. */
function wordless(status) {
  const cure = { 413: "send smaller photographs, or fewer: a proxy before the service limits them", 502: AGAIN, 503: AGAIN, 504: AGAIN }[status];
  return { title: "Error", detail: `the service answered ${status}`, cure };
}

/** A response, with the page told (`awaited`) while one that changes nothing takes long. */
async function answered(path, sent) {
  if (sent.method !== "GET") return fetch(path, sent); // photographs may be on their way for minutes
  const told = (more) => document.dispatchEvent(new CustomEvent("awaited", { detail: more }));
  let late = false;
  const timer = setTimeout(() => { late = true; told(1); }, PATIENCE_MS);
  try {
    return await fetch(path, sent);
  } finally {
    clearTimeout(timer);
    if (late) told(-1);
  }
}

/** A successful response. Throws `Refused` for any other. */
export async function ask(path, { method = "GET", headers = {}, body, signal } = {}) {
  const key = sessionStorage.getItem(KEY);
  const sent = { method, body, signal, headers: keyed(headers) };
  let response;
  try {
    response = await answered(path, sent);
  } catch (error) {
    if (!(error instanceof TypeError)) throw error;
    throw new Refused(await silence(body));
  }
  if (response.ok) return response;
  let problem = await response.json().catch(() => null);
  if (response.status === 401 && sessionStorage.getItem(KEY) !== key) { // another one came meanwhile
    return ask(path, { method, headers, body, signal });
  }
  if (typeof problem?.title !== "string") problem = wordless(response.status);
  if (response.status === 401) document.dispatchEvent(new CustomEvent("key-needed", { detail: { refused: key !== null } }));
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

/** The body of a path as an object URL, which the caller revokes. */
export const askPicture = async (path, options) => URL.createObjectURL(await askBlob(path, options));

/** Load a path into an image, and revoke the object URL that it had; nothing for one that was removed from the page. */
export async function showPicture(image, path) {
  if (!image.isConnected) return;
  const address = await askPicture(path);
  if (!image.isConnected) return void URL.revokeObjectURL(address);
  if (image.src.startsWith("blob:")) URL.revokeObjectURL(image.src);
  image.src = address;
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
