/** @file Audit: who did what and what was refused, filtered, its chain checked where it is read. */

import { element, fill } from "../element.js";
import { canCheck, misfits } from "../lists/audit_chain.js";
import { instantInput, instantMs, instantText } from "../lists/instant_input.js";
import { newestFirst } from "../lists/newest_first.js";
import { symbol } from "../parts/symbol.js";
import { field, foreign, row, table } from "../lists/table.js";
import { utc, words } from "../words.js";

export const name = "audit";

const ROLES = ["", "viewer", "station", "operator", "approver", "admin"];
const COLUMNS = ["number", "at", "who", "action", "target", "outcome", "address", "chain"];
const HASH_SHOWN = 12;
const ENDS = ["start", "stop"];

/** @param {{parameters: URLSearchParams, go: (view: string, parameters: Object<string, string>) => void}} context */
export function show({ parameters, go }) {
  const summary = element("p", { role: "status" });
  const list = newestFirst("/audit", drawn);
  let drawnLast = 0;

  function drawn(rows, answer) {
    const cells = new Map(rows.map((entry) => [entry.number, element("span", { class: "chain", title: entry.hash }, entry.hash.slice(0, HASH_SHOWN))]));
    check(rows, answer.head, cells);
    const columns = COLUMNS.map((each) => words(`views.audit.column.${each}`));
    return table(words("views.audit.title"), columns, rows.map((entry) => rowOf(entry, cells.get(entry.number))));
  }

  async function check(rows, head, cells) {
    const turn = (drawnLast += 1);
    if (!canCheck()) return fill(summary, symbol("off"), " ", words("views.audit.unchecked"));
    const wrong = await misfits(rows, head);
    if (turn !== drawnLast) return summary;
    for (const number of wrong) fill(cells.get(number), symbol("critical"), " ", words("views.audit.broken"));
    const text = words(wrong.size ? "views.audit.wrong" : "views.audit.sound", { count: wrong.size || rows.length, head: head.number });
    return fill(summary, symbol(wrong.size ? "critical" : "normal"), " ", text);
  }

  const inputs = {
    who: element("input", { maxLength: 200, value: parameters.get("who") ?? "" }),
    role: element("select", {}, ROLES.map((role) => element("option", { value: role, selected: role === parameters.get("role") }, role ? words(`app.role.${role}`) : words("views.audit.any")))),
    action: element("input", { maxLength: 200, value: parameters.get("action") ?? "" }),
    outcome: element("input", { maxLength: 200, value: parameters.get("outcome") ?? "" }),
    target: element("input", { maxLength: 200, value: parameters.get("target") ?? "" }),
    ...Object.fromEntries(ENDS.map((end) => [end, instantInput({ value: (parameters.get(end) ?? "").slice(0, 19).replace("T", " ") })])),
  };
  const given = () => Object.fromEntries(Object.entries(inputs).map(([key, input]) => [key, ENDS.includes(key) && Number.isFinite(instantMs(input)) ? instantText(input) : input.value.trim()]).filter(([, value]) => value));
  const filter = element("form", { class: "tools", onsubmit: (event) => (event.preventDefault(), go("audit", given())) },
    Object.entries(inputs).map(([key, input]) => field(words(`views.audit.filter.${key}`), input)),
    element("button", { type: "submit", class: "primary" }, words("views.audit.apply")));
  list.load(given());
  return {
    node: element("section", { class: "audit", "aria-label": words("views.audit.title") }, element("h1", {}, words("views.audit.title")), filter, summary, list.node),
    close: list.close,
  };
}

function rowOf(entry, chain) {
  const who = [foreign(entry.who), entry.role && element("p", { class: "detail" }, words(`app.role.${entry.role}`))];
  const outcome = [entry.outcome === "done" ? words("views.audit.done") : entry.outcome, entry.times > 1 && ` × ${entry.times}`];
  return row(entry.number, utc(entry.at), who, foreign(entry.action), foreign(entry.target), outcome, foreign(entry.address), chain);
}
