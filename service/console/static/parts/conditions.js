/** @file Conditions of the verdict on control, each with value and limit, and how far the good minutes are. */

import { element } from "../element.js";
import { duration, meaning, number, utc, words } from "../words.js";
import { symbol } from "./symbol.js";

const DIGITS = { deg: 3, dB: 2, "%": 0 };
const LEVELS = { inhibit: "caution", trip: "critical", yaw: "standby" };

/**
 * Return tables of conditions: those that are not met, those with a limit, the others folded.
 * @param {any} control Answer of `GET …/control`.
 */
export function conditions(control) {
  const unmet = control.conditions.filter((each) => each.met === false);
  const rest = control.conditions.filter((each) => each.met !== false);
  const measured = rest.filter((each) => each.value !== null);
  const others = rest.filter((each) => each.value === null);
  return [
    goodMinutes(control.good_minutes),
    table([...unmet, ...measured]),
    element("details", {}, element("summary", {}, words("views.control.others", { count: others.length })), table(others)),
  ];
}

function goodMinutes({ since, elapsed_s, needed_s }) {
  const text = words("views.control.good", { elapsed: duration(elapsed_s), needed: duration(needed_s) });
  const bar = element("progress", { max: needed_s, value: elapsed_s, "aria-label": words("views.control.goodLabel") });
  return element("p", { class: "good-minutes" }, bar, " ", text, since && ` (${words("views.control.goodSince", { at: utc(since) })})`);
}

function table(rows) {
  const heads = ["met", "condition", "value", "limit", "since"].map((each) => element("th", { scope: "col" }, words(`views.control.column.${each}`)));
  return element("table", { class: "conditions" }, element("thead", {}, element("tr", {}, heads)), element("tbody", {}, rows.map(rowOf)));
}

function rowOf(condition) {
  const { code, met, consequence, value, limit, bound, unit, since } = condition;
  const state = met === null ? "unjudged" : met ? "met" : consequence;
  const next = met === false && meaning("reasons", code, "next");
  const relation = { greatest: "≤", least: "≥" }[bound] ?? "";
  return element("tr", { "data-code": code, "data-met": String(met) },
    element("td", { class: "nowrap" }, symbol(met === false ? LEVELS[consequence] : met ? "normal" : "off"), " ", words(`views.control.met.${state}`)),
    element("th", { scope: "row" }, meaning("reasons", code), next && element("span", { class: "detail next" }, next)),
    element("td", { class: "figure" }, figure(value, unit)),
    element("td", { class: "figure" }, limit === null ? "" : `${relation} ${figure(limit, unit)}`),
    element("td", {}, since && [element("span", { class: "nowrap" }, utc(since, "date")), " ", utc(since, "time")]),
  );
}

function figure(value, unit) {
  if (value === null) return "";
  if (unit === "s") return `${value < 0 ? "−" : ""}${duration(value)}`;
  return `${number(value, DIGITS[unit] ?? 0)}${unit && ` ${words(`views.control.unit.${unit === "%" ? "percent" : unit}`)}`}`;
}
