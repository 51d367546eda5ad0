/** @file Links: front ends and analyzers, what each reports, what is missing or refused, and the sources of rows. */

import { Problem, get, post } from "../api.js";
import { element, fill } from "../element.js";
import { failure } from "../parts/problem.js";
import { linkLevel, symbol } from "../parts/symbol.js";
import { duration, linkStateWords, meaning, number, utc, words } from "../words.js";

export const name = "links";
const AGAIN_MS = 5000;
const COUNTERS = ["rows", "accepted", "duplicates", "late", "refused", "failures", "waiting", "faults"];
const HEADS = ["link", "state", "lastRow", "rate", "counters", "warnings"];

/** @param {{store: any, spacecraft: any, session: any}} context */
export function show({ store, spacecraft, session }) {
  const mayOperate = session.permissions.includes("operate");
  const said = element("div", { role: "status" });
  const [links, sources] = [element("div"), element("div")];
  const closing = new AbortController();
  const former = new Map();
  let timer = 0;
  let drawn = "";

  async function refresh() {
    try {
      const [found, heads] = await Promise.all([get("/links"), get(`/spacecraft/${spacecraft.id}/sources`)]);
      if (closing.signal.aborted) return;
      const mine = found.links.filter((link) => !link.spacecraft_id || link.spacecraft_id === spacecraft.id);
      draw(mine, heads.rows);
      fill(said);
    } catch (error) {
      if (!closing.signal.aborted) fill(said, failed(error));
    }
  }

  async function keepFresh() {
    await refresh();
    if (!closing.signal.aborted) timer = setTimeout(keepFresh, AGAIN_MS);
  }

  /** Order something; the link hears of it with its next report. */
  async function order(path, event) {
    event.currentTarget.disabled = true;
    try {
      await post(path);
      await refresh();
    } catch (error) {
      fill(said, failed(error));
    } finally {
      drawn = "";
    }
  }

  function draw(mine, heads) {
    const key = JSON.stringify([mine, heads]);
    if (key === drawn) return;
    drawn = key;
    const body = mine.map((link) => rowOf(link, rateOf(link, former), mayOperate && ((verb) => (event) => order(`/links/${encodeURIComponent(link.id)}:${verb}`, event))));
    fill(links, mine.length ? table(HEADS, body) : element("p", {}, words("views.links.none")));
    const prime = (id) => (event) => order(`/spacecraft/${spacecraft.id}/sources/${encodeURIComponent(id)}:select`, event);
    fill(sources, heads.length ? table(["source", "role", "newest", "rows"], heads.map((each) => sourceOf(each, mayOperate && prime(each.id)))) : element("p", {}, words("views.links.noSources")));
  }

  const ends = [store.on("link", refresh)];
  keepFresh();
  return {
    node: element("section", { class: "links-view", "aria-label": words("views.links.title") }, element("h1", {}, words("views.links.title")), said, links, element("h2", {}, words("views.links.sources")), sources),
    close() {
      closing.abort();
      clearTimeout(timer);
      ends.forEach((end) => end());
    },
  };
}

const failed = (error) => failure(error instanceof Problem ? error : new Problem({ detail: String(error) }));

function table(heads, rows) {
  const cells = heads.map((each) => element("th", { scope: "col" }, words(`views.links.column.${each}`)));
  return element("div", { class: "wide", tabIndex: 0, role: "group", "aria-label": words("views.links.title") }, element("table", {}, element("thead", {}, element("tr", {}, cells)), element("tbody", {}, rows)));
}

/** Return rows a minute since the report before; null where there is none, or the counter began again. */
function rateOf({ id, reported_at, counters }, former) {
  const now = { at: Date.parse(reported_at), rows: counters.rows, rate: null };
  const last = former.get(id);
  if (last && now.at === last.at) return last.rate;
  if (last && now.at > last.at && now.rows >= last.rows) now.rate = (60_000 * (now.rows - last.rows)) / (now.at - last.at);
  former.set(id, now);
  return now.rate;
}

function rowOf(link, rate, orderOf) {
  const { state, detail, counters, warnings, enabled } = link;
  const dropped = Object.entries(counters).filter(([key, count]) => key.startsWith("dropped_") && count > 0);
  const counts = COUNTERS.filter((key) => key in counters).map((key) => [words(`views.links.counter.${key}`), counters[key]]);
  if (dropped.length) counts.push([words("views.links.counter.dropped"), dropped.reduce((sum, [, count]) => sum + count, 0)]);
  if (link.rows_missing !== null) counts.push([words("views.links.counter.missing"), link.rows_missing]);
  const buttons = orderOf && [
    element("button", { type: "button", onclick: orderOf(enabled ? "disable" : "enable") }, words(enabled ? "views.links.disable" : "views.links.enable")),
    element("button", { type: "button", onclick: orderOf("reset") }, words("views.links.reset")),
  ];
  const about = [detail?.analyzer, detail?.last_fault, detail?.last_failure].filter((each) => typeof each === "string" && each);
  return element("tr", { "data-link": link.id, "data-state": state },
    element("th", { scope: "row" }, element("bdi", {}, link.id), element("p", { class: "detail" }, words(`views.links.kind.${link.kind}`)), about.map((each) => element("p", { class: "detail" }, element("bdi", {}, each)))),
    element("td", {}, symbol(linkLevel(link)), " ", linkStateWords(state), element("p", { class: "detail" }, words("views.links.reported", { age: duration(link.age_s) })), link.reset_pending && element("p", {}, words("views.links.resetPending")), buttons),
    element("td", {}, link.last_good ? [utc(link.last_good), element("p", { class: "detail" }, words("views.links.ago", { age: duration(link.last_good_age_s) }))] : words("views.links.noRow")),
    element("td", {}, rate === null ? "" : words("views.links.rate", { rate: number(rate, 1) }), detail?.period_s >= 1 && element("p", { class: "detail" }, words("views.links.period", { period: duration(detail.period_s) }))),
    element("td", {}, element("dl", { class: "facts" }, counts.map(([label, count]) => [element("dt", {}, label), element("dd", {}, number(count, 0))]))),
    element("td", {}, warnings.map((each) => warningOf(each))),
  );
}

function warningOf({ code, detail, since }) {
  const said = [meaning("problems", code), meaning("problems", code, "next"), since && words("views.links.since", { at: utc(since) })].filter(Boolean);
  return element("div", {}, symbol("caution"), " ", said.join(" "), element("p", { class: "detail", lang: "en" }, element("bdi", {}, detail)));
}

function sourceOf({ id, role, newest_epoch, rows, station, key_id }, select) {
  const sender = [station, key_id && words("views.links.key", { key: key_id })].filter(Boolean).join(", ");
  return element("tr", { "data-source": id }, element("th", { scope: "row" }, element("bdi", {}, id), sender && element("p", { class: "detail" }, element("bdi", {}, sender))),
    element("td", {}, words(`views.links.role.${role}`), " ", role !== "prime" && select && element("button", { type: "button", onclick: select }, words("views.links.makePrime"))),
    element("td", {}, utc(newest_epoch)), element("td", {}, number(rows, 0)),
  );
}
