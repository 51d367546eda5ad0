/** @file Stop: one click or Alt+S, then Enter, in every view; what the service answered, or that it did not. */

import { Problem, post } from "../api.js";
import { element, fill, setText } from "../element.js";
import { meaning, utc, words } from "../words.js";
import { failure } from "./problem.js";
import { symbol } from "./symbol.js";

/** A service that has said nothing for so long has not stopped anything as far as anybody knows. */
const ANSWER_MS = 10_000;

/**
 * Return button and panel; both outlive the views. The order needs no stream, so it goes out while that is cut.
 * @param {any} store
 * @returns {{button: any, panel: any, draw: () => void}} `draw`: after a change of language or session.
 */
export function stopControl(store) {
  const button = element("button", { type: "button", class: "stop", "aria-keyshortcuts": "Alt+S", onclick: ask });
  const panel = element("div", { class: "stop-panel", hidden: true, onkeydown: leave });
  let sending = null;

  const isOffered = () => Boolean(store.get().spacecraft && store.get().session?.permissions.includes("operate"));

  function draw() {
    setText(button, words("app.stop.button"));
    button.hidden = !isOffered();
    if (!isOffered()) hide();
    // a click on another view has moved the focus there, and Enter must still stop
    else if (!panel.hidden) queueMicrotask(() => panel.querySelector(".danger")?.focus());
  }

  function hide() {
    sending?.abort();
    sending = null;
    panel.hidden = true;
    fill(panel);
  }

  function leave(event) {
    if (event.key !== "Escape") return;
    hide();
    button.focus();
  }

  function show(role, ...children) {
    panel.hidden = false;
    fill(panel, element("div", { role, "aria-label": words("app.stop.title") }, children));
  }

  const closing = (key) => element("button", { type: "button", onclick: () => (hide(), button.focus()) }, words(`app.stop.${key}`));

  /** Ask for Enter; the spacecraft is the one that was chosen when Stop was asked for, whatever is chosen then. */
  function ask() {
    if (sending) return;
    const { id } = store.get().spacecraft;
    const sure = element("button", { type: "button", class: "danger", onclick: () => send(id) }, words("app.stop.confirm"));
    show("alertdialog", symbol("critical"), element("p", {}, words("app.stop.question", { spacecraft: id })), sure, closing("back"));
    sure.focus();
  }

  async function send(id) {
    sending = new AbortController();
    const mine = sending;
    show("alert", symbol("standby"), element("p", {}, words("app.stop.sending", { spacecraft: id })));
    try {
      const signal = AbortSignal.any([mine.signal, AbortSignal.timeout(ANSWER_MS)]);
      const control = await post(`/spacecraft/${id}/control:stop`, {}, { signal });
      if (store.get().spacecraft?.id === id) store.set({ control });
      const text = words("app.stop.done", { spacecraft: id, state: meaning("states", control.state), at: utc(control.since) });
      show("alert", symbol(control.state === "TRIPPED" ? "normal" : "critical"), element("p", {}, text), closing("close"));
    } catch (error) {
      if (mine.signal.aborted) return;
      const problem = error instanceof Problem ? error : new Problem({ detail: String(error) });
      const again = element("button", { type: "button", class: "danger", onclick: () => send(id) }, words("app.stop.again"));
      show("alert", symbol("critical"), element("p", {}, words("app.stop.failed", { spacecraft: id })), failure(problem), again, closing("close"));
      again.focus();
    } finally {
      if (sending === mine) sending = null;
    }
  }

  document.addEventListener("keydown", (event) => {
    // by the key's position: the letter is another in a Russian layout
    if (!event.altKey || event.ctrlKey || event.metaKey || event.code !== "KeyS" || !isOffered()) return;
    event.preventDefault();
    ask();
  });
  return { button, panel, draw };
}
