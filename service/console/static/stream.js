/**
 * @file The live stream: one connection for all tabs of a browser, resumed without loss and without doubling.
 *
 * A browser opens six connections to an address by HTTP/1.1. The tab that holds a lock reads the stream and passes its
 * events on; when it closes, the next tab goes on from the last event it has seen.
 */

import { Problem, address, get, open, problemOf } from "./api.js";

/** The service beats each 2.5 s; silence of so long is a cut. */
const SILENCE_MS = 8000;
/** After a refusal that names no time, what is newest is asked for again. */
const REFUSED_S = 2;
const WAITS_MS = [500, 1000, 2000, 5000];
/** Of events seen; the tab that takes over may see a few of them again. */
const REMEMBERED = 4000;
const OPEN_STATES = ["open"];
/** Events that each have an id of their own; others have that of the instant they came at, several of them the same. */
const NUMBERED = ["measurement", "attitude", "torque", "alarm"];

/**
 * Follow a spacecraft: fill the store and publish each event.
 * @param {any} store @param {string} spacecraft
 * @returns {{close: () => void, refresh: () => Promise<void>}}
 */
export function follow(store, spacecraft) {
  const ending = new AbortController();
  const channel = new BroadcastChannel(`soo-stream-${spacecraft}`);
  const seen = new Set();
  let lastId = "";
  let isLeading = false;
  let silence = 0;
  let renewal = 0;
  let refreshes = 0;

  const isOver = () => ending.signal.aborted;
  const send = (message) => isOver() || channel.postMessage(message);

  function setLink(state, problem = null) {
    const former = store.get().link;
    if (former.state !== state || former.problem?.code !== problem?.code) {
      const since = former.state === state ? former.since : Date.now();
      store.set({ link: { state, since, problem: problem && { ...problem } } });
    }
    if (isLeading) send({ link: store.get().link });
  }

  function heard() {
    clearTimeout(silence);
    if (!isOver()) silence = setTimeout(() => setLink("cut", new Problem({ code: "stream.silent" })), SILENCE_MS);
  }

  function receive({ id, kind, text }) {
    const content = JSON.parse(text);
    const mark = `${kind} ${id}`;
    // an archive that was set back gives its ids again
    if (kind === "dropped") seen.clear();
    else if (NUMBERED.includes(kind)) {
      if (seen.has(mark)) return;
      seen.add(mark);
      if (seen.size > REMEMBERED) seen.delete(seen.values().next().value);
    }
    lastId = id;
    if (kind === "dropped" && !content.follows) {
      // who reads again at this event must not ask for the span of rows that are no more
      refresh().then(() => isOver() || store.publish(kind, content));
      return;
    }
    keep(store, kind, content, renew);
    store.publish(kind, content);
  }

  channel.onmessage = ({ data }) => {
    if (isOver()) return;
    if (data.hello && isLeading) send({ link: store.get().link, beat: true });
    if (data.beat) heard();
    if (data.link) store.set({ link: data.link });
    if (data.event) {
      heard();
      receive(data.event);
    }
  };

  async function read() {
    const timer = new AbortController();
    let timeout = setTimeout(() => timer.abort(), SILENCE_MS);
    const signal = AbortSignal.any([ending.signal, timer.signal]);
    try {
      const headers = lastId ? { "Last-Event-ID": lastId } : {};
      const answer = await open(address(`/spacecraft/${spacecraft}/stream`), { headers, signal });
      if (!answer.ok) throw await problemOf(answer);
      setLink("live");
      if (!lastId) refresh(); // a stream without a last id tells nothing of the rows before it
      for await (const event of eventsOf(answer.body)) {
        clearTimeout(timeout);
        timeout = setTimeout(() => timer.abort(), SILENCE_MS);
        heard();
        if (event === null) send({ beat: true });
        else {
          receive(event);
          send({ event });
        }
      }
      throw new Problem({ code: "stream.ended" });
    } catch (error) {
      throw timer.signal.aborted ? new Problem({ code: "stream.silent" }) : error;
    } finally {
      clearTimeout(timeout);
    }
  }

  async function lead() {
    isLeading = true;
    for (let failures = 0; !isOver(); failures += 1) {
      const began = performance.now();
      try {
        await read();
      } catch (error) {
        if (isOver()) return;
        if (performance.now() - began > SILENCE_MS) failures = 0;
        const problem = error instanceof Problem ? error : new Problem({ detail: String(error) });
        setLink("cut", problem);
        const wait = WAITS_MS[Math.min(failures, WAITS_MS.length - 1)];
        await pause(Math.max(wait, 1000 * (problem.retryAfter ?? 0)), ending.signal);
      }
    }
  }

  /** Read what is newest: at the beginning, and when events are missing. What an event brought meanwhile is newer. */
  async function refresh() {
    const base = `/spacecraft/${spacecraft}`;
    const before = store.get();
    const turn = (refreshes += 1);
    const found = await Promise.allSettled([
      get(`${base}/attitude`, { method: "robust" }),
      get(`${base}/attitude`, { method: "paper" }),
      get(`${base}/torques`),
      get(`${base}/control`),
      get(`${base}/alarms`, { state: OPEN_STATES }),
      get(`${base}/status`),
    ]);
    if (isOver() || turn < refreshes) return; // a later answer is newer
    const [robust, paper, torque, control, alarms, status] = found.map((each) => each.value ?? null);
    // what the service does not hold is an answer; what it refused is asked for again
    const problem = found.find(({ reason }) => reason instanceof Problem && reason.status !== 404)?.reason ?? null;
    clearTimeout(renewal);
    if (problem) renewal = setTimeout(refresh, 1000 * (problem.retryAfter ?? REFUSED_S));
    const now = store.get();
    const newer = (part, read) => (now[part] === before[part] ? read : now[part]);
    const rows = Object.entries({ robust, paper }).map(([method, read]) => [method, now.attitude[method] === before.attitude[method] ? read : now.attitude[method]]);
    store.set({
      problem,
      measurement: newer("measurement", null),
      attitude: Object.fromEntries(rows.filter(([, row]) => row)),
      torque: newer("torque", torque),
      control: newer("control", control),
      alarms: newer("alarms", alarms?.rows ?? now.alarms),
      ...(status && now.status === before.status && { status, statusAt: performance.now() }),
    });
  }

  const applied = new Map();
  let asked = 0;

  /** Read a part again; an answer that a later one has overtaken is thrown away. */
  async function renew(part, path, valueOf, params = {}) {
    const turn = (asked += 1);
    try {
      const answer = await get(`/spacecraft/${spacecraft}${path}`, params);
      if (isOver() || turn < (applied.get(part) ?? 0)) return;
      applied.set(part, turn);
      store.set({ [part]: valueOf(answer) });
    } catch {
      // the next event, or the next connection, brings it; the header says that the service does not answer
    }
  }

  heard();
  send({ hello: true });
  refresh();
  // without a secure context there are no locks: each tab has a stream of its own
  if (navigator.locks) {
    navigator.locks.request(`soo-stream-${spacecraft}`, { signal: ending.signal }, lead).catch(() => {});
  } else lead();
  return {
    refresh,
    close() {
      ending.abort();
      clearTimeout(silence);
      clearTimeout(renewal);
      channel.close();
    },
  };
}

/** Put an event into the store. */
function keep(store, kind, content, renew) {
  const state = store.get();
  if (kind === "status") {
    const isSame = JSON.stringify(content.control) === JSON.stringify(state.status?.control);
    store.set({ status: content, statusAt: performance.now() });
    if (!isSame) renew("control", "/control", (control) => control);
  } else if (kind === "attitude") store.set({ attitude: { ...state.attitude, [content.method]: content } });
  else if (kind === "torque") store.set({ torque: content });
  else if (kind === "measurement") store.set({ measurement: content });
  else if (kind === "alarm") renew("alarms", "/alarms", ({ rows }) => rows, { state: OPEN_STATES });
}

/** Yield the events of a body; null for a beat. */
async function* eventsOf(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const blocks = (rest + value).split("\n\n");
    rest = blocks.pop() ?? "";
    for (const block of blocks) {
      const fields = Object.fromEntries(block.split("\n").map((line) => [line.split(":", 1)[0], line.replace(/^\w*: ?/, "")]));
      yield fields.data === undefined ? null : { id: fields.id, kind: fields.event, text: fields.data };
    }
  }
}

function pause(ms, signal) {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, ms);
    signal.addEventListener("abort", () => (clearTimeout(timer), resolve(undefined)), { once: true });
  });
}
