/** @file The worst open alarm, how many there are, and their acknowledgement. */

import { Problem, post } from "../api.js";
import { element, every, fill } from "../element.js";
import { meaning, words } from "../words.js";
import { problemText } from "./problem.js";
import { LEVELS, SEVERITY_LEVEL, symbol } from "./symbol.js";

const rank = (alarm) => LEVELS.indexOf(SEVERITY_LEVEL[alarm.severity]);

/** Return the open alarms that are neither shelved nor suppressed, worst and newest first. */
export function pressing(alarms) {
  return alarms
    .filter((alarm) => !["shelved", "suppressed"].includes(alarm.state))
    .sort((one, other) => rank(one) - rank(other) || other.raised_at.localeCompare(one.raised_at));
}

/** @param {any} store */
export function alarmSummary(store) {
  const node = element("span", { class: "alarms", role: "status" });
  const said = element("span", { role: "alert" });
  let drawn = null;
  const draw = () => {
    const { alarms, link } = store.get();
    const isCut = link.state === "cut";
    if (drawn?.alarms === alarms && drawn.isCut === isCut) return;
    drawn = { alarms, isCut };
    const open = pressing(alarms);
    const worst = open[0];
    const mayOperate = store.get().session?.permissions.includes("operate");
    const waiting = open.filter((alarm) => ["unacknowledged", "returned"].includes(alarm.state));
    const acknowledge = async (event) => {
      event.currentTarget.disabled = true;
      const results = await Promise.allSettled(waiting.map(({ id }) => post(`/alarms/${id}:acknowledge`, {})));
      const refused = results.find((each) => each.reason instanceof Problem);
      fill(said, refused && problemText(refused.reason));
      drawn = null;
    };
    fill(node, symbol(worst ? SEVERITY_LEVEL[worst.severity] : isCut ? "off" : "normal"),
      element("a", { href: "#/alarms" }, worst ? words("app.alarms.open", { count: open.length, worst: meaning("alarms", worst.condition) }) : words(isCut ? "app.alarms.unknown" : "app.alarms.none")),
      mayOperate && waiting.length > 0 && element("button", { type: "button", onclick: acknowledge }, words("app.alarms.acknowledge", { count: waiting.length })),
      said,
    );
  };
  return every(draw, node);
}
