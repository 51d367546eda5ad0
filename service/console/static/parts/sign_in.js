/** @file The form for a key: the key goes to the service once, the cookie that comes back is read by no script. */

import { Problem } from "../api.js";
import { element, fill } from "../element.js";
import { words } from "../words.js";
import { languageChooser, themeChooser } from "./choosers.js";
import { failure } from "./problem.js";

/**
 * @param {{open: (key: string) => Promise<void>, problem: any, changeLanguage: (language: string) => void, changeTheme: (theme: string) => void}} given
 */
export function signIn({ open, problem, changeLanguage, changeTheme }) {
  const said = element("div", { "aria-live": "assertive" }, problem && failure(problem));
  const key = element("input", { id: "key", type: "password", autocomplete: "off", required: true, maxLength: 256, autofocus: true });
  const button = element("button", { type: "submit", class: "primary" }, words("app.signIn.button"));
  const submit = async (event) => {
    event.preventDefault();
    button.disabled = true;
    try {
      await open(key.value.trim());
    } catch (error) {
      fill(said, failure(error instanceof Problem ? error : new Problem({ detail: String(error) })));
      key.select();
    } finally {
      key.value = "";
      button.disabled = false;
    }
  };
  return element("main", { class: "sign-in" }, element("h1", {}, words("app.signIn.title")),
    element("form", { onsubmit: submit }, element("label", { htmlFor: "key" }, words("app.signIn.key")), key, button), said,
    element("p", { class: "detail" }, words("app.signIn.explanation")),
    element("p", { class: "choosers" }, languageChooser(changeLanguage), themeChooser(changeTheme)),
  );
}
