/** @file The one sentence: the situation as the service found it, whether torques may go, the reason, the next step. */

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
  const { allowed, state, reasons, situation } = status.control;
  const conditions = control?.conditions ?? [];
  const known = situationWords(situation ?? {});
  const owed = OWED.find((each) => control?.[each]?.length);
  if (allowed && owed) return words(`views.now.sentence.${owed}`, { known, number: control[owed].join(", ") });
  const step = meaning("situations", situation?.code, "next");
  const torque = words(`views.now.sentence.${state === "BALANCE" ? "balance" : "noTorque"}`);
  if (!allowed && step) return words("views.now.sentence.plain", { known, torque, next: step });
  // before the first row nothing else can be mended
  const first = status.newest_measurement === null ? reasons.find((each) => each.code === "no_attitude") : null;
  const [worst, ...others] = first ? [first, ...reasons.filter((each) => each !== first)] : reasons;
  const more = others.length ? words("views.now.more", { count: others.length }) : "";
  const reason = worst && [reasonText(worst, conditions, row), more].filter(Boolean).join(" ");
  const next = worst && meaning("reasons", worst.code, "next");
  const key = allowed ? (worst ? "allowedBut" : "allowed") : "forbidden";
  return words(`views.now.sentence.${key}`, { known, torque, reason, next });
}

/** Return the words of the worst that is true now, as the service found it. */
function situationWords({ code, axis, severity, ...figures }) {
  const values = Object.fromEntries(Object.entries(figures).map(([name, value]) => [name, number(value, 2)]));
  return meaning("situations", code, "name", { ...values, axis: axis && words(`app.axis.${axis}`).toLowerCase() });
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
