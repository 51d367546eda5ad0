/** @file Keys: who may speak to the service, a new key, which is shown once, and the end of one. */

import { Problem, get, post, remove } from "../api.js";
import { element, fill } from "../element.js";
import { ask } from "../lists/dialog.js";
import { failure } from "../parts/problem.js";
import { field, foreign, row, table } from "../lists/table.js";
import { utc, words } from "../words.js";

export const name = "keys";

const ROLES = ["viewer", "station", "operator", "approver", "admin"];
const COLUMNS = ["name", "role", "state", "created", "expires", "used", "actions"];
const DAY_MS = 86_400_000;
const DAYS = [1, 30, 365, 0];
const NAME_LENGTH = 64;

/** @param {{store: any, session: any}} context */
export function show({ store }) {
  const ending = new AbortController();
  const body = element("div");
  const said = element("div", { "aria-live": "polite" });
  const revoked = element("input", { type: "checkbox", onchange: load });

  async function load() {
    try {
      const { rows } = await get("/keys", { revoked: revoked.checked }, { signal: ending.signal });
      fill(said);
      fill(body, rows.length ? table(words("views.keys.list"), COLUMNS.map((each) => words(`views.keys.column.${each}`)), rows.map(rowOf)) : element("p", { class: "notice" }, words("app.list.empty")));
    } catch (error) {
      if (ending.signal.aborted) return;
      if (!(error instanceof Problem)) throw error;
      fill(said, failure(error), element("button", { type: "button", onclick: load }, words("app.list.again")));
    }
  }

  function rowOf(key) {
    const end = key.state !== "revoked" && element("button", { type: "button", onclick: () => revoke(key) }, words("views.keys.revoke"));
    const expires = key.expires_at ? utc(key.expires_at) : words("views.keys.never");
    const made = [utc(key.created_at), " ", foreign(key.created_by)];
    return row(foreign(key.name), words(`app.role.${key.role}`), words(`views.keys.state.${key.state}`), made, expires, utc(key.last_used_at), end);
  }

  function revoke(key) {
    ask({
      title: words("views.keys.revokeTitle"),
      body: element("p", {}, foreign(key.name), " ", words("views.keys.consequence")),
      confirm: words("views.keys.revoke"),
      act: async () => {
        await remove(`/keys/${key.id}`);
        await load();
      },
    });
  }

  const holder = element("input", { required: true, maxLength: NAME_LENGTH, autocomplete: "off" });
  const role = element("select", {}, ROLES.map((each) => element("option", { value: each }, words(`app.role.${each}`))));
  const life = element("select", {}, DAYS.map((days) => element("option", { value: days, selected: days === DAYS[2] }, days ? words("views.keys.days", { count: days }) : words("views.keys.never"))));
  const shown = element("div", { "aria-live": "assertive" });
  const button = element("button", { type: "submit", class: "primary" }, words("views.keys.make"));
  async function make(event) {
    event.preventDefault();
    button.disabled = true;
    const days = Number(life.value);
    // by the clock of the service: that of the workstation may be wrong
    const expires = days ? new Date(Date.now() + store.get().offsetMs + days * DAY_MS).toISOString() : null;
    try {
      const made = await post("/keys", { name: holder.value, role: role.value, expires_at: expires });
      holder.value = "";
      fill(shown, secret(made));
      await load();
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      fill(shown, failure(error));
    } finally {
      button.disabled = false;
    }
  }

  /** The key is on the page until it is put away, and nowhere else. */
  function secret(made) {
    const value = element("input", { readOnly: true, value: made.key, class: "secret", "aria-label": words("views.keys.secret"), onfocus: () => value.select() });
    const away = element("button", { type: "button", onclick: () => fill(shown) }, words("views.keys.away"));
    return element("div", { class: "failure" }, element("div", {}, element("p", {}, words("views.keys.once"), " ", foreign(made.name)), element("p", { class: "choosers" }, value, away)));
  }

  const form = element("form", { class: "tools", onsubmit: make }, field(words("views.keys.column.name"), holder), field(words("views.keys.column.role"), role), field(words("views.keys.life"), life), button);
  load();
  return {
    node: element("section", { class: "keys", "aria-label": words("views.keys.title") },
      element("h1", {}, words("views.keys.title")), form, shown,
      element("label", { class: "labelled inline" }, revoked, words("views.keys.revoked")), said, body),
    close: () => ending.abort(),
  };
}
