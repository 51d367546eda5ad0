/** @file A question that waits for an answer: what will happen, fields, one button that does it. */

import { Problem } from "../api.js";
import { element, fill } from "../element.js";
import { words } from "../words.js";
import { failure } from "../parts/problem.js";

/**
 * Ask; the answer of the service, or its refusal, is shown before the question goes away.
 * @param {{title: string, body: any, confirm: string, act: () => Promise<void>}} asked
 */
export function ask({ title, body, confirm, act }) {
  const said = element("div", { "aria-live": "assertive" });
  const button = element("button", { type: "submit", class: "primary" }, confirm);
  const submit = async (event) => {
    event.preventDefault();
    button.disabled = true;
    try {
      await act();
      node.close();
    } catch (error) {
      fill(said, failure(error instanceof Problem ? error : new Problem({ detail: String(error) })));
      button.disabled = false;
    }
  };
  const cancel = element("button", { type: "button", onclick: () => node.close() }, words("app.dialog.cancel"));
  const form = element("form", { onsubmit: submit }, element("h2", { id: "dialog-title" }, title), body, said, element("p", { class: "choosers" }, button, cancel));
  const node = element("dialog", { "aria-labelledby": "dialog-title", onclose: () => node.remove() }, form);
  document.body.append(node);
  node.showModal();
}
