/** @file Alarms: worst first, acknowledged one by one or all that are shown, shelved with time and comment, their history and limits. */

import { Problem, get, post } from "../api.js";
import { element, fill } from "../element.js";
import { soundSwitch } from "../lists/alarm_sound.js";
import { pressing } from "../parts/alarm_summary.js";
import { ask } from "../lists/dialog.js";
import { newestFirst, soon } from "../lists/newest_first.js";
import { failure } from "../parts/problem.js";
import { SEVERITY_LEVEL, symbol } from "../parts/symbol.js";
import { choice, field, foreign, row, table } from "../lists/table.js";
import { meaning, number, utc, words } from "../words.js";

export const name = "alarms";

/** What is listed, and the states that the service gives for it. */
const LISTS = { open: ["open"], covered: ["shelved", "suppressed"], history: ["open", "shelved", "suppressed", "closed"] };
const SEVERITIES = ["watch", "warning", "distress", "critical", "severe"];
const WAITING = ["unacknowledged", "returned"];
const SHELVE_MINUTES = [15, 60, 240, 480, 1440];
const COLUMNS = ["severity", "condition", "value", "raised", "state", "actions"];
const DIGITS = 2;

/** @param {{store: any, spacecraft: any, session: any, parameters: URLSearchParams}} context */
export function show({ store, spacecraft, session, parameters }) {
  const base = `/spacecraft/${spacecraft.id}`;
  const mayOperate = session.permissions.includes("operate");
  const said = element("div", { "aria-live": "assertive" });
  const body = element("div");
  const ending = new AbortController();
  let shown = parameters.get("list") in LISTS || parameters.get("list") === "limits" ? parameters.get("list") : "open";
  const list = newestFirst(`${base}/alarms`, (rows) => drawn(rows));
  /** Opened histories by alarm: a list that is drawn anew keeps them. */
  const histories = new Map();

  function drawn(rows) {
    const ordered = shown === "open" ? pressing(rows) : rows;
    const waiting = ordered.filter((alarm) => WAITING.includes(alarm.state));
    const all = mayOperate && waiting.length > 1 &&
      element("button", { type: "button", onclick: (event) => acknowledge(event, waiting) }, words("views.alarms.acknowledgeAll", { count: waiting.length }));
    const columns = COLUMNS.map((each) => words(`views.alarms.column.${each}`));
    return [all && element("p", {}, all), table(words("views.alarms.title"), columns, ordered.map((alarm) => rowOf(alarm)))];
  }

  function rowOf(alarm) {
    const severity = [symbol(SEVERITY_LEVEL[alarm.severity]), " ", meaning("severities", alarm.severity)];
    const next = alarm.cause ? words("views.alarms.followsNext") : meaning("alarms", alarm.condition, "next") || alarm.next_step;
    const following = alarm.children?.length > 0 && element("details", {}, element("summary", {}, words("views.alarms.children", { count: alarm.children.length })), element("ul", {}, alarm.children.map(childOf)));
    const condition = [element("strong", {}, meaning("alarms", alarm.condition)), " ", foreign(alarm.thing), element("p", { class: "detail" }, next), following];
    return row(severity, condition, [valueOf(alarm), element("p", { class: "detail whole" }, words("views.alarms.limit", { limit: number(alarm.limit, DIGITS) }))], utc(alarm.raised_at), stateOf(alarm), actionsOf(alarm));
  }

  function actionsOf(alarm) {
    const button = (key, act) => element("button", { type: "button", onclick: act }, words(`views.alarms.${key}`));
    const isOpen = alarm.state !== "normal";
    const isShelved = alarm.state === "shelved";
    const history = histories.get(alarm.id) ?? element("div");
    if (histories.has(alarm.id)) showHistory(alarm, history);
    const buttons = element("div", { class: "actions" },
      mayOperate && WAITING.includes(alarm.state) && button("acknowledge", (event) => acknowledge(event, [alarm])),
      mayOperate && isOpen && !isShelved && button("shelve", () => shelve(alarm)),
      mayOperate && isShelved && button("unshelve", (event) => order(event, alarm, "unshelve")),
      mayOperate && alarm.state === "latched" && button("clear", (event) => order(event, alarm, "clear")),
      button("history", () => (histories.delete(alarm.id) ? fill(history) : showHistory(alarm, history))));
    return [buttons, history];
  }

  /** One after the other: a hundred at once would be refused for their rate. */
  async function acknowledge(event, alarms) {
    event.currentTarget.disabled = true;
    const failures = [];
    for (const alarm of alarms) {
      try {
        await post(`/alarms/${alarm.id}:acknowledge`, {});
      } catch (error) {
        if (!(error instanceof Problem)) throw error;
        failures.push(failure(error));
        // another person has closed it: the others are still to be acknowledged
        if (error.status !== 409) break;
      }
    }
    fill(said, failures);
    await list.reload();
  }

  async function order(event, alarm, action) {
    event.currentTarget.disabled = true;
    try {
      await post(`/alarms/${alarm.id}:${action}`, {});
      fill(said);
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      fill(said, failure(error));
    }
    await list.reload();
  }

  function shelve(alarm) {
    const minutes = element("select", {}, SHELVE_MINUTES.map((each) => element("option", { value: each }, words("views.alarms.minutes", { count: each }))));
    const comment = element("textarea", { rows: 3, maxLength: 1000, required: true });
    ask({
      title: words("views.alarms.shelveTitle", { name: meaning("alarms", alarm.condition) }),
      body: [element("p", {}, foreign(alarm.thing)), field(words("views.alarms.shelveFor"), minutes), field(words("views.alarms.comment"), comment)],
      confirm: words("views.alarms.shelve"),
      act: async () => {
        const { now } = await get(`${base}/status`);
        const until = new Date(new Date(now ?? Date.now()).getTime() + Number(minutes.value) * 60_000).toISOString();
        await post(`/alarms/${alarm.id}:shelve`, { until, comment: comment.value });
        await list.reload();
      },
    });
  }

  async function showHistory(alarm, host) {
    histories.set(alarm.id, host);
    try {
      const { changes } = await get(`/alarms/${alarm.id}`, {}, { signal: ending.signal });
      if (histories.has(alarm.id)) fill(host, element("ol", { class: "changes" }, changes.map((change) =>
        element("li", {}, `${utc(change.at)} ${words(`views.alarms.change.${change.change}`)} `, change.by && [words("views.alarms.by"), " ", foreign(change.by)], change.comment && [": ", foreign(change.comment)]))));
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      fill(host, failure(error));
    }
  }

  async function showLimits() {
    try {
      const { sets, conditions } = await get(`${base}/alarm-limits/in-force`, {}, { signal: ending.signal });
      if (shown !== "limits") return;
      const columns = [words("views.alarms.column.condition"), ...SEVERITIES.map((each) => meaning("severities", each)), words("views.alarms.delay")];
      const rows = Object.entries(conditions).map(([condition, limits]) =>
        row([meaning("alarms", condition), " ", element("span", { class: "detail" }, meaning("units", limits.unit))], ...SEVERITIES.map((each) => number(limits[each], DIGITS)), number(limits.on_s, 0)));
      const inForce = sets.map((each) => words(`views.alarms.set.${each}`)).join(", ");
      fill(body, element("p", {}, words("views.alarms.sets", { sets: inForce })), table(words("views.alarms.list.limits"), columns, rows));
    } catch (error) {
      if (ending.signal.aborted) return;
      if (!(error instanceof Problem)) throw error;
      fill(body, failure(error));
    }
  }

  function choose(value) {
    shown = value;
    fill(said);
    if (value === "limits") {
      fill(body);
      showLimits();
    } else {
      fill(body, list.node);
      list.load({ state: LISTS[value] });
    }
  }

  const options = [...Object.keys(LISTS), "limits"].map((each) => [each, words(`views.alarms.list.${each}`)]);
  const bar = element("div", { class: "tools" }, choice(words("views.alarms.lists"), options, choose, shown), soundSwitch(store));
  const renew = () => shown !== "limits" && list.reload();
  const ends = [store.on("alarm", soon(renew)), store.subscribe((state) => state.link.state, (state) => state === "live" && renew())];
  choose(shown);
  return {
    node: element("section", { class: "alarm-list", "aria-label": words("views.alarms.title") }, element("h1", {}, words("views.alarms.title")), bar, said, body),
    close() {
      ends.forEach((end) => end());
      ending.abort();
      list.close();
    },
  };
}

/** Return the newest value with its epoch; while none is known, the one that raised the alarm. */
const valueOf = (alarm) => [element("span", { class: "whole" }, `${number(alarm.present_value ?? alarm.value, DIGITS)} ${meaning("units", alarm.unit)}`), " ", element("span", { class: "detail" }, utc(alarm.present_at ?? alarm.value_at))];
const childOf = (alarm) => element("li", {}, symbol(SEVERITY_LEVEL[alarm.severity]), " ", meaning("alarms", alarm.condition), " ", foreign(alarm.thing), " ", valueOf(alarm));

/** Return the state, and who did what about it. */
function stateOf(alarm) {
  const handled = alarm.state === "shelved" ? alarm.shelved : (alarm.cleared ?? alarm.acknowledged);
  const until = alarm.state === "shelved" && alarm.shelved_until ? ` ${words("views.alarms.until", { at: utc(alarm.shelved_until) })}` : "";
  return [
    alarm.cause && alarm.state === "suppressed" ? [words("views.alarms.follows"), " ", meaning("alarms", alarm.cause[0])] : words(`views.alarms.state.${alarm.state}`),
    until,
    handled && element("p", { class: "detail" }, words("views.alarms.by"), " ", foreign(handled.by), ` ${utc(handled.at)} `, foreign(handled.comment)),
  ];
}
