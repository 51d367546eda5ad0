/** @file Symbols of states: a shape for each level, so that colour is never the only sign. */

import { svg } from "../element.js";

/** Shapes of Astro UXDS, in a square of 16. */
const SHAPES = {
  critical: "M8 1 15 15H1Z",
  serious: "M8 1 15 8 8 15 1 8Z",
  caution: "M2 2H14V14H2Z",
  normal: "M8 1.5A6.5 6.5 0 1 1 8 14.5 6.5 6.5 0 1 1 8 1.5Z",
  standby: "M8 1.5A6.5 6.5 0 1 1 8 14.5 6.5 6.5 0 1 1 8 1.5ZM8 5.5A2.5 2.5 0 1 0 8 10.5 2.5 2.5 0 1 0 8 5.5Z",
  off: "M2 7H14V9H2Z",
};

/** Levels of the severities of alarms. */
export const SEVERITY_LEVEL = { severe: "critical", critical: "critical", distress: "serious", warning: "caution", watch: "standby" };

/** From worst to best. */
export const LEVELS = Object.keys(SHAPES);

/** Return the symbol of a level; the word stands beside it. @param {string} level One of LEVELS. */
export function symbol(level) {
  const shape = svg("path", { d: SHAPES[level] ?? SHAPES.off, "fill-rule": "evenodd" });
  return svg("svg", { class: `symbol ${level}`, viewBox: "0 0 16 16", "aria-hidden": "true" }, shape);
}

/** States in which a link works, and levels of others. */
const WORKING = ["MEASURE", "RUNNING"];
const LINK_LEVELS = { SILENT: "critical", STUCK: "critical", SERVICE_AWAY: "serious", BACKOFF: "serious", STOPPED: "off" };

/** Return the level of a link, or of a source without one. @param {any} link */
export function linkLevel({ state, enabled, warnings, rows_missing: missing }) {
  if (enabled === false || state === "DISABLED") return "off";
  if (state && !WORKING.includes(state)) return LINK_LEVELS[state] ?? "caution";
  return warnings.length || missing ? "caution" : "normal";
}
