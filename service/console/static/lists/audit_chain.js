/** @file The chain of the audit log, checked where it is read: an entry that was changed, taken out or put in does not fit. */

/** Fields of an entry in the order in which its hash covers them; the instant goes first, in microseconds. */
const FIELDS = ["who", "key_id", "role", "address", "action", "target", "outcome", "request_id", "body_sha256", "times"];
const GENESIS = "0".repeat(64);

/** Return whether this page may compute hashes; a browser allows it over TLS and on the machine itself. */
export const canCheck = () => Boolean(globalThis.crypto?.subtle);

/**
 * Return the numbers of the entries that do not fit.
 * @param {any[]} entries Newest first; some between them may be missing, of a filter.
 * @param {{number: number, hash: string}} head Newest entry of the whole log.
 */
export async function misfits(entries, head) {
  const found = new Set();
  const byNumber = new Map(entries.map((entry) => [entry.number, entry]));
  for (const entry of entries) {
    const former = byNumber.get(entry.number - 1)?.hash ?? (entry.number === 1 ? GENESIS : entry.previous_hash);
    const isHead = entry.number !== head.number || entry.hash === head.hash;
    const fits = entry.previous_hash === former && isHead && entry.hash === (await hashOf(entry));
    if (!fits) found.add(entry.number);
  }
  return found;
}

/** SHA-256 over the JSON list of previous hash, number and all fields, in ASCII, without blanks. */
async function hashOf(entry) {
  // microseconds are more than a number of this language holds with its fields side by side: digits
  const [whole, fraction] = entry.at.replace("Z", "").split(".");
  const at = `${Date.parse(`${whole}Z`) / 1000}${(fraction ?? "").padEnd(6, "0")}`;
  const rest = FIELDS.map((name) => ascii(JSON.stringify(entry[name])));
  const text = `[${[`"${entry.previous_hash}"`, entry.number, at, ...rest].join(",")}]`;
  const digest = await crypto.subtle.digest("SHA-256", new TextEncoder().encode(text));
  return [...new Uint8Array(digest)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

function ascii(json) {
  return json.replace(/[\u007f-\uffff]/g, (letter) => `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`);
}
