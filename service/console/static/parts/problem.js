/** @file A problem in words: what happened, what next. */

import { element } from "../element.js";
import { meaning, number, words } from "../words.js";
import { symbol } from "./symbol.js";

/** Return what a problem says, as one line of words. @param {any} problem */
export function problemText(problem) {
  // without a status the page itself has met it
  const group = problem.status === 0 ? "faults" : "problems";
  const known = meaning(group, problem.code);
  const name = known === problem.code ? words("app.problem.unknown", { code: problem.code, status: problem.status }) : known;
  const next = meaning(group, problem.code, "next");
  const wait = problem.retryAfter ? words("app.problem.retryAfter", { seconds: number(problem.retryAfter, 0) }) : "";
  return [name, next, wait].filter(Boolean).join(" ");
}

/** Return a problem to be shown where the answer would stand. @param {any} problem */
export function failure(problem) {
  const detail = problem.detail && element("p", { class: "detail", lang: "en" }, problem.detail);
  return element("div", { class: "failure", role: "alert" }, symbol("critical"), element("div", {}, element("p", {}, problemText(problem)), detail));
}
