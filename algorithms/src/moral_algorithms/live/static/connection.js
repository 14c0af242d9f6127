/** The way to the server: a stream of events that reconnects by itself, and requests. */

/** Without a sign of life for so long (milliseconds), the connection is taken for lost. */
const SILENCE = 12_000;
const REQUEST_TIMEOUT = 8_000;
const FIRST_DELAY = 250;
const LAST_DELAY = 2_000;

const sleep = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** An answer of the server that says no. */
export class Refusal extends Error {
  constructor(status, { error, detail, ...more }) {
    super(detail ?? `The server answered ${status}.`);
    this.status = status;
    this.code = error ?? "";
    this.more = more;
  }
}

/**
 * Ask the server.
 *
 * @param {string} path
 * @param {object=} body With one, it is a POST.
 * @returns {Promise<object>}
 * @throws {Refusal} If the server says no.
 * @throws {TypeError|DOMException} If the server is not reached.
 */
export async function request(path, body) {
  const options = { signal: AbortSignal.timeout(REQUEST_TIMEOUT), cache: "no-store" };
  if (body !== undefined) {
    options.method = "POST";
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  const response = await fetch(path, options);
  if (response.ok) return response.json();
  throw new Refusal(response.status, await response.json().catch(() => ({})));
}

/**
 * The newer of two QUEUEs: a reply and an event may arrive in the other order than they were told in.
 *
 * @param {object|null|undefined} before
 * @param {object|null} told
 * @returns {object|null}
 */
export function newerQueue(before, told) {
  return before && told && before.session === told.session && before.revision > told.revision ? before : told;
}

/** A name that nobody else draws, for what must not be counted twice. */
export function drawKey() {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * Follow the server's events for as long as the page is open.
 *
 * @param {object} on
 * @param {(name: string, value: object) => void} on.event
 * @param {() => void} on.lost The connection broke; it is tried again without end.
 * @param {() => void} on.ended The server is another one now and does not know this page.
 */
export async function follow(on) {
  for (let delay = FIRST_DELAY; ; delay = Math.min(2 * delay, LAST_DELAY)) {
    try {
      await readEvents((name, value) => {
        delay = FIRST_DELAY;
        on.event(name, value);
      });
    } catch (error) {
      if (error instanceof Refusal && error.status === 401) {
        on.ended();
        return;
      }
    }
    on.lost();
    await sleep(delay);
  }
}

async function readEvents(onEvent) {
  const control = new AbortController();
  let alarm = setTimeout(() => control.abort(), SILENCE);
  try {
    const response = await fetch("api/events", { signal: control.signal, cache: "no-store" });
    if (!response.ok) throw new Refusal(response.status, await response.json().catch(() => ({})));
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      clearTimeout(alarm);
      alarm = setTimeout(() => control.abort(), SILENCE);
      text += value.replaceAll("\r", "");
      const blocks = text.split("\n\n");
      text = blocks.pop();
      blocks.forEach((block) => readBlock(block, onEvent));
    }
  } finally {
    clearTimeout(alarm);
    control.abort();
  }
}

function readBlock(block, onEvent) {
  let name = "message";
  const data = [];
  for (const line of block.split("\n")) {
    const [field, ...rest] = line.split(":");
    const value = rest.join(":").replace(/^ /, "");
    if (field === "event") name = value;
    else if (field === "data") data.push(value);
  }
  if (data.length > 0) onEvent(name, JSON.parse(data.join("\n")));
}
