/** @file Tables of plain cells; a text from outside stands by itself, so that no mark of direction in it reaches others. */

import { element } from "../element.js";

/** @param {string} label For who does not see it. @param {string[]} columns Headings. @param {any[]} rows Rows of the body. */
export function table(label, columns, rows) {
  const headings = columns.map((each) => element("th", { scope: "col" }, each));
  return element("div", { class: "scroll", tabIndex: 0, role: "group", "aria-label": label },
    element("table", {}, element("thead", {}, element("tr", {}, headings)), element("tbody", {}, rows)));
}

/** @param {string | null | undefined} text Of a person or another system. */
export function foreign(text) {
  return element("bdi", { class: "foreign" }, text ?? "");
}

/** @param {...any} cells The first names the row. */
export function row(first, ...cells) {
  return element("tr", {}, element("th", { scope: "row" }, first), cells.map((cell) => element("td", {}, cell)));
}

/**
 * A chooser of one of some words.
 * @param {string} label @param {[string, string][]} options Values and words. @param {(value: string) => void} change
 * @param {string} chosen
 */
export function choice(label, options, change, chosen = options[0][0]) {
  const buttons = options.map(([value, text]) =>
    element("button", { type: "button", "aria-pressed": value === chosen, onclick: () => choose(value) }, text));
  function choose(value) {
    buttons.forEach((button, index) => button.setAttribute("aria-pressed", String(options[index][0] === value)));
    change(value);
  }
  return element("span", { class: "chooser", role: "group", "aria-label": label }, buttons);
}

/** A labelled field of a form. @param {string} label @param {any} input */
export function field(label, input) {
  return element("label", { class: "labelled" }, element("span", {}, label), input);
}
