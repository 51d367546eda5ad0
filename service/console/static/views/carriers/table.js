/** @file The table of carriers: one row each, sorted by any column. */

import { element, fill, setText } from "../../element.js";
import { number, words } from "../../words.js";
import { reasonWords, stateLevel, stateRank, stateWords } from "./words.js";
import { symbol } from "../../parts/symbol.js";

/**
 * Columns: what a row is sorted by, and its text.
 * @type {{name: string, key: (carrier: any, state: any, reason?: string) => any, text: (carrier: any, state: any, reason?: string) => string, isNumber?: boolean}[]}
 */
const COLUMNS = [
  { name: "carrier", key: ({ id }) => id, text: ({ id }) => id },
  { name: "state", key: (_, state) => stateRank(state), text: (_, state) => stateWords(state) },
  { name: "reason", key: (_, state, reason) => reasonWords(state, reason), text: (_, state, reason) => reasonWords(state, reason) },
  figure("power", "power_dbm", 2),
  figure("deviation", "deviation_db", 2),
  figure("residual", "residual_db", 2, Math.abs),
  figure("cN0", "c_n0_db_hz", 1),
  { name: "transponder", key: ({ transponder }) => transponder, text: ({ transponder }) => transponder },
  { name: "station", key: ({ station }) => station?.name ?? "", text: ({ station }) => station?.name ?? "" },
];

function figure(name, member, digits, keyOf = (value) => value) {
  const of = (state) => state?.[member];
  return { name, key: (_, state) => (Number.isFinite(of(state)) ? keyOf(of(state)) : null), text: (_, state) => number(of(state), digits), isNumber: true };
}

export function carrierTable() {
  let sorting = { name: "state", sign: 1 };
  let rows = [];
  let last = null;
  const heads = COLUMNS.map(head);
  const body = element("tbody");
  const table = element("table", {}, element("caption", { class: "detail" }, words("views.carriers.caption")), element("thead", {}, element("tr", {}, heads)), body);

  function head({ name, isNumber }) {
    const button = element("button", { type: "button", onclick: () => sort(name) }, words(`views.carriers.column.${name}`));
    return element("th", { scope: "col", class: isNumber ? "figure" : "" }, button);
  }

  function sort(name) {
    sorting = { name, sign: sorting.name === name ? -sorting.sign : 1 };
    arrange();
  }

  /** Put the rows in order; what is not known stands last either way. */
  function arrange() {
    COLUMNS.forEach(({ name }, k) => {
      if (name === sorting.name) heads[k].setAttribute("aria-sort", sorting.sign > 0 ? "ascending" : "descending");
      else heads[k].removeAttribute("aria-sort");
    });
    if (!last) return;
    const { key } = COLUMNS.find(({ name }) => name === sorting.name) ?? COLUMNS[0];
    const keyed = rows.map((row, k) => ({ row, k, key: key(row.carrier, last.states.get(row.carrier.id), last.reasons.get(row.carrier.id)) }));
    keyed.sort((a, b) => compared(a.key, b.key, sorting.sign) || a.k - b.k);
    keyed.forEach(({ row }, k) => {
      // a row that stays keeps the focus
      if (body.children[k] !== row.node) body.insertBefore(row.node, body.children[k] ?? null);
    });
  }

  return {
    node: element("div", { class: "scroll" }, table),
    /** @param {any[]} carriers Of a new plan. */
    reset(carriers) {
      rows = carriers.map(rowOf);
      fill(body, rows.map(({ node }) => node));
    },
    draw(carriers) {
      last = carriers;
      for (const row of rows) row.draw(carriers.states.get(row.carrier.id), carriers.reasons.get(row.carrier.id));
      arrange();
    },
  };
}

function compared(a, b, sign) {
  const [isA, isB] = [a !== null && a !== "", b !== null && b !== ""];
  if (!isA || !isB) return Number(isB) - Number(isA);
  return sign * (typeof a === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true }));
}

function rowOf(carrier) {
  const mark = element("span", { class: "mark" });
  const texts = COLUMNS.map(() => element("bdi"));
  let level = "";
  const cells = COLUMNS.map(({ name, isNumber }, k) => {
    if (name === "carrier") return element("th", { scope: "row" }, element("a", { href: carrierAddress(carrier.id), title: carrier.name }, texts[k]));
    return element("td", { class: isNumber ? "figure" : name, title: name === "station" ? carrier.station?.name : null }, name === "state" && mark, texts[k]);
  });
  return {
    carrier,
    node: element("tr", {}, cells),
    draw(state, reason) {
      COLUMNS.forEach(({ text }, k) => setText(texts[k], text(carrier, state, reason)));
      if (stateLevel(state) === level) return;
      level = stateLevel(state);
      // grey by default: a symbol stands for what is abnormal
      fill(mark, level !== "normal" && symbol(level));
    },
  };
}

/** Return the address of the view of one carrier. */
export const carrierAddress = (id) => `#/carriers?${new URLSearchParams({ carrier: id })}`;
