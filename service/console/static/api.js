/** @file Requests to the REST interface by the cookie of the session; no key is kept here. */

const BASE = new URL("../api/v1", document.baseURI);

/** Angles by their names in the interface, in the order in which every view shows them. */
export const AXES = ["yaw", "roll", "pitch"];

/** Refusal of the service, or its absence (code `network`). */
export class Problem extends Error {
  /** @param {{status?: number, code?: string, title?: string, detail?: string, errors?: any[], retryAfter?: number | null}} problem */
  constructor({ status = 0, code = "network", title = "", detail = "", errors = [], retryAfter = null }) {
    super(detail || title || code);
    Object.assign(this, { status, code, title, detail, errors, retryAfter });
  }
}

/** Set by the page: what follows an answer. */
export const listeners = { unauthorized: () => {}, clock: (/** @type {number} */ _offsetMs) => {} };

/**
 * Return the address of a resource, for links too.
 * @param {string} path @param {Object<string, any>} params Null and undefined are left out, lists are repeated.
 */
export function address(path, params = {}) {
  const url = new URL(BASE.href + path);
  for (const [name, value] of Object.entries(params)) {
    for (const one of [value].flat()) if (one !== null && one !== undefined) url.searchParams.append(name, String(one));
  }
  return url.href;
}

/** @param {string} path @param {Object<string, any>} params @param {{signal?: AbortSignal}} options */
export const get = (path, params = {}, options = {}) => ask("GET", address(path, params), undefined, options);

/**
 * @param {string} path @param {any} body
 * @param {{key?: string, signal?: AbortSignal, params?: Object<string, any>}} options `key` of a second person, for this one request.
 */
export const post = (path, body = undefined, options = {}) => ask("POST", address(path, options.params), body, options);

/** @param {string} path @param {any} body @param {{signal?: AbortSignal}} options */
export const put = (path, body, options = {}) => ask("PUT", address(path), body, options);

/** @param {string} path @param {any} body @param {{signal?: AbortSignal}} options */
export const patch = (path, body, options = {}) => ask("PATCH", address(path), body, options);

/** @param {string} path @param {{signal?: AbortSignal}} options */
export const remove = (path, options = {}) => ask("DELETE", address(path), undefined, options);

/**
 * Return an answer whose body is read by the caller.
 * @param {string} url @param {RequestInit} init
 * @returns {Promise<Response>}
 */
export async function open(url, init) {
  const began = Date.now();
  let answer;
  try {
    answer = await fetch(url, { credentials: "same-origin", cache: "no-store", ...init });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new Problem({ detail: String(error) });
  }
  const serverMs = Date.parse(answer.headers.get("date") ?? "");
  // the header has whole seconds
  if (Number.isFinite(serverMs)) listeners.clock(serverMs + 500 - (began + Date.now()) / 2);
  return answer;
}

async function ask(method, url, body, { key, signal } = {}) {
  const headers = { ...(body === undefined ? {} : { "Content-Type": "application/json" }) };
  if (key !== undefined) headers.Authorization = `Bearer ${key}`;
  const answer = await open(url, { method, headers, signal, body: body === undefined ? undefined : JSON.stringify(body) });
  if (!answer.ok) throw await problemOf(answer, key === undefined);
  return answer.status === 204 ? null : answer.json();
}

/**
 * Return the problem of an answer that is none.
 * @param {Response} answer @param {boolean} isOwn Whether the request came with the session of the page.
 */
export async function problemOf(answer, isOwn = true) {
  const problem = await answer.json().catch(() => ({}));
  const wait = Number(answer.headers.get("retry-after"));
  const code = problem.code ?? `http.${answer.status}`;
  if (answer.status === 401 && isOwn) listeners.unauthorized();
  return new Problem({ ...problem, status: answer.status, code, retryAfter: wait > 0 ? wait : null });
}
