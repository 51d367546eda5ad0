/** @file Choice of language and theme. */

import { element, setText } from "../element.js";
import { LANGUAGES, language, words } from "../words.js";

/** @param {(language: string) => void} change */
export function languageChooser(change) {
  return element("span", { class: "chooser", role: "group", "aria-label": words("app.language") },
    LANGUAGES.map((each) =>
      element("button", { type: "button", lang: each, "aria-pressed": each === language(), onclick: () => change(each) }, each.toUpperCase()),
    ),
  );
}

/** @param {(theme: string) => void} change */
export function themeChooser(change) {
  const other = () => (document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  const button = element("button", { type: "button" }, words(`app.theme.${other()}`));
  button.addEventListener("click", () => {
    change(other());
    setText(button, words(`app.theme.${other()}`));
  });
  return button;
}
