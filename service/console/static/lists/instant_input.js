/** @file Fields for an instant or a day in UTC, written as everywhere on the page and not as the workstation's country does. */

import { element } from "../element.js";
import { words } from "../words.js";

const FORM = /^\d{4}-\d\d-\d\d([ T]\d\d:\d\d(:\d\d)?Z?)?$/;

/** Return the milliseconds of what was written; NaN where that is no instant, as on 31 February. */
export function instantMs({ value }) {
  const text = value.trim().replace("T", " ").replace(/Z$/, "");
  const ms = FORM.test(text) ? Date.parse(`${text.replace(" ", "T")}${text.length > 10 ? "Z" : ""}`) : NaN;
  return Number.isFinite(ms) && new Date(ms).toISOString().startsWith(text.slice(0, 10)) ? ms : NaN;
}

/** Return what was written as the interface has it; null: nothing. */
export const instantText = (input) => (input.value.trim() ? new Date(instantMs(input)).toISOString() : null);

/** Write an instant, or the day of it, into its field. @param {any} input @param {number} ms */
export function writeInstant(input, ms) {
  input.value = new Date(ms).toISOString().slice(0, Number(input.maxLength)).replace("T", " ");
  input.setCustomValidity("");
}

/** A field for an instant; a form with one that is none is not sent. @param {Object<string, any>} attributes */
export const instantInput = (attributes = {}) => checked({ maxLength: 19, size: 19, placeholder: words("app.instant.both"), ...attributes });

/** A field for a day. @param {Object<string, any>} attributes */
export const dayInput = (attributes = {}) => checked({ maxLength: 10, size: 10, placeholder: words("app.instant.day"), ...attributes });

function checked({ oninput, ...attributes }) {
  const input = element("input", { class: "instant", autocomplete: "off", ...attributes });
  input.addEventListener("input", () => {
    const isWrong = input.value.trim() && Number.isNaN(instantMs(input));
    input.setCustomValidity(isWrong ? words("app.instant.wrong") : "");
    oninput?.();
  });
  return input;
}
