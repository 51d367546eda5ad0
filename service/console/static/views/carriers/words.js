/** @file What a carrier's state and reason are called, and how bad they are. */

import { meaning, words } from "../../words.js";

const LEVELS = { used: "normal", absent: "serious", excluded: "caution", unselected: "off", uncalibrated: "off" };
/** From worst to best. */
const ORDER = ["absent", "excluded", "uncalibrated", "unselected", "used"];

/** @param {any} state Newest state of a carrier, undefined where there is none. */
export const stateLevel = (state) => LEVELS[state?.state] ?? "off";

/** @param {any} state */
export function stateRank(state) {
  const rank = ORDER.indexOf(state?.state);
  return rank < 0 ? ORDER.length : rank;
}

/** @param {any} state */
export const stateWords = (state) => (state ? meaning("carriers", state.state) : words("views.carriers.noState"));

/**
 * Return why a carrier is left out and what the references make of it, in words.
 * @param {any} state @param {string | undefined} reason
 */
export function reasonWords(state, reason) {
  const hypothesis = state?.hypothesis && state.hypothesis !== "dry" ? meaning("hypotheses", state.hypothesis) : "";
  return [reason ? meaning("exclusions", reason) : "", hypothesis].filter(Boolean).join("; ");
}

/** Return what to do about a reason. @param {string | undefined} reason */
export const reasonNext = (reason) => (reason ? meaning("exclusions", reason, "next") : "");
