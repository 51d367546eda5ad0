/** @file The one sentence: what is known, whether torques may go, the worst reason, the next step. */

import { meaning, number, utc, words } from "../words.js";

/** Commands that a person has to act on, in this order. */
const OWED = ["open_commands", "unreported_commands"];
/** What the number of a condition is measured in, and its digits. */
const UNITS = { deg: ["deg", 2], dB: ["db", 1], "%": ["percent", 0] };

/**
 * Return the sentence.
 * @param {any} status Answer of `GET …/status`. @param {any} row Newest row of the method that drives control.
 * @param {any} control Answer of `GET …/control`, null: not there yet.
 */
export function sentence(status, row, control) {
  const { allowed, reasons } = status.control;
  const conditions = control?.conditions ?? [];
  const owed = OWED.find((each) => control?.[each]?.length);
  if (allowed && owed) return words(`views.now.sentence.${owed}`, { known: knowledge(row), number: control[owed].join(", ") });
  // before the first row nothing else can be mended
  const first = status.newest_measurement === null ? reasons.find((each) => each.code === "no_attitude") : null;
  const [worst, ...others] = first ? [first, ...reasons.filter((each) => each !== first)] : reasons;
  const more = others.length ? words("views.now.more", { count: others.length }) : "";
  const reason = worst && [reasonText(worst, conditions, row), more].filter(Boolean).join(" ");
  const next = worst && meaning("reasons", worst.code, "next");
  const key = allowed ? (worst ? "allowedBut" : "allowed") : "forbidden";
  return words(`views.now.sentence.${key}`, { known: knowledge(row), reason, next });
}

/** Return what is known of the angles. */
function knowledge(row) {
  if (!row) return meaning("statuses", "NOT_RECEIVED");
  if (row.status === "INVALID") return words("views.now.unknown");
  const sigma = Math.max(row.sigma_deg.roll ?? NaN, row.sigma_deg.pitch ?? NaN);
  if (row.status !== "ACQUIRED" || !Number.isFinite(sigma)) return meaning("statuses", row.status);
  // rounded up: never better than it is
  return words("views.now.known", { sigma: number(Math.ceil(200 * sigma) / 100, 2) });
}

function reasonText(reason, conditions, row) {
  const condition = conditions.find((each) => each.code === reason.code);
  const isFade = ["fade", "downlink_fade"].includes(reason.code);
  const [value, limit] = isFade ? [row?.downlink_fade_db, null] : [condition?.value, condition?.limit];
  const [unit, digits] = UNITS[isFade ? "dB" : condition?.unit] ?? [];
  const ofLimit = Number.isFinite(limit) && words("views.now.ofAlert", { alert: number(limit, digits) });
  const size = Number.isFinite(value) && unit && [number(value, digits), ofLimit, words(`app.unit.${unit}`)].filter(Boolean).join(" ");
  const since = reason.since ?? condition?.since;
  const name = meaning("reasons", reason.code);
  return [ofLimit && size ? `${name},` : name, size, since && words("views.now.since", { at: utc(since, "minute") })].filter(Boolean).join(" ");
}
