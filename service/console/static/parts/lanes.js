/** @file Lanes below curves: intervals and marks of the timeline, on the span of the panels above. */

import { LEFT_PX, RIGHT_PX } from "../chart.js";
import { element, fill, svg } from "../element.js";
import { meaning, utc, words } from "../words.js";
import { SEVERITY_LEVEL } from "./symbol.js";

const HEIGHT_PX = 14;
/** A mark, or an interval that is shorter, is as wide. */
const LEAST_PX = 3;
/** The status that needs no bar. */
const GOOD = "ACQUIRED";
/** Lines of a tooltip. */
const MOST_TEXTS = 8;

/**
 * @typedef {Object} Item
 * @property {number} start s since 1970.
 * @property {number} stop
 * @property {string} level Of symbols.
 * @property {string} text
 */

/**
 * Return the lanes of a timeline, items in order of start.
 * @param {any} timeline Answer of `GET …/timeline`. @param {string} method Whose states are shown.
 * @param {number} present s since 1970: what has not ended lasts until then.
 * @returns {{name: string, items: Item[]}[]}
 */
export function lanesOf(timeline, method, present) {
  const seconds = (epoch) => (epoch ? Date.parse(epoch) / 1000 : present);
  const item = (start, stop, level, text) => ({ start: seconds(start), stop: Math.max(seconds(stop), seconds(start)), level, text });
  const title = (key, values) => words(`views.history.item.${key}`, values);
  const runs = (kind, level, textOf) =>
    timeline.states
      .filter((run) => run.kind === kind && run.method === method && run.name !== GOOD)
      .map((run) => item(run.start, run.stop, level, textOf(run)));
  const marks = [
    ...timeline.calibrations.map((each) => item(each.at, each.at, "standby", title("calibration", { id: each.calibration_id, method: each.method }))),
    ...timeline.alignments.map((each) => item(each.epoch, each.epoch, "standby", title("alignment", { id: each.id, source: each.source }))),
    ...timeline.corrections.map((each) => item(each.start, each.stop, "standby", title("correction"))),
    ...timeline.notes.map((each) => item(each.epoch, each.epoch, "off", title("note", each))),
  ];
  const lanes = {
    control: runs("inhibition", "serious", (run) => meaning("reasons", run.name)),
    status: runs("status", "caution", (run) => meaning("statuses", run.name)),
    fade: runs("fade", "caution", () => title("fade")),
    exclusions: runs("exclusion", "off", (run) => title("exclusion", { carrier: run.carrier, reason: meaning("exclusions", run.name) })),
    gaps: timeline.gaps.map((gap) => item(gap.start, gap.stop, "critical", title("gap", { count: gap.rows_missing }))),
    operations: timeline.operations.map((each) => item(each.start, each.stop, "standby", title("operation", each))),
    commands: timeline.commands.map((each) => item(each.start, each.stop, "standby", title("command", { id: each.id, state: meaning("commands", each.state) }))),
    alarms: timeline.alarms.map((each) => item(each.since, each.returned_at, SEVERITY_LEVEL[each.severity] ?? "off", title("alarm", { name: meaning("alarms", each.condition), thing: each.thing }))),
    marks: marks.sort((one, other) => one.start - other.start),
  };
  return Object.entries(lanes).map(([name, items]) => ({ name, items }));
}

/**
 * Return the drawing of lanes on a span.
 * @param {{name: string, items: Item[]}[]} lanes @param {[number, number]} span s since 1970.
 * @param {number} width Of the panels above, px.
 */
export function drawnLanes(lanes, span, width) {
  return lanes.map(({ name, items }) => drawnLane(name, items, span, width));
}

function drawnLane(name, items, [start, stop], width) {
  const wide = Math.max(width - LEFT_PX - RIGHT_PX, 1);
  const scale = wide / (stop - start);
  const inside = items.filter((each) => each.stop >= start && each.start <= stop);
  const bars = joined(inside.map((each) => ({
    left: Math.max(0, (each.start - start) * scale),
    right: Math.min(wide, Math.max((each.stop - start) * scale, (each.start - start) * scale + LEAST_PX)),
    level: each.level,
    texts: [textOf(each)],
  })));
  const label = words(`views.history.lane.${name}`);
  const drawing = svg("svg",
    { class: "lane", role: "img", width: wide, height: HEIGHT_PX, "aria-label": words("views.history.laneSummary", { lane: label, count: inside.length }) },
    bars.map((bar) =>
      svg("rect", { class: bar.level, x: bar.left, y: 2, width: Math.max(bar.right - bar.left, 1), height: HEIGHT_PX - 4 }, svg("title", {}, bar.texts.join("\n"))),
    ),
  );
  return element("div", { class: "lane-row" }, element("span", { class: "lane-name", style: { width: `${LEFT_PX}px` } }, label), drawing);
}

/** Return bars of which those that nobody could tell apart are one; it names the first of them. */
function joined(bars) {
  const found = [];
  for (const bar of bars) {
    const before = found.at(-1);
    if (before && before.level === bar.level && bar.left < before.right + 1) {
      before.right = Math.max(before.right, bar.right);
      if (before.texts.length < MOST_TEXTS) before.texts.push(...bar.texts);
    } else found.push(bar);
  }
  return found;
}

/** Return an item in words with its ends. @param {Item} item */
export function textOf({ start, stop, text }) {
  const [from, until] = [utc(start * 1000), utc(stop * 1000)];
  return from === until ? `${from} ${text}` : `${from} – ${until} ${text}`;
}

/**
 * Return the items of lanes as a table.
 * @param {{name: string, items: Item[]}[]} lanes @param {[number, number]} span @param {number} most Rows.
 */
export function laneTable(lanes, [start, stop], most) {
  const all = lanes.flatMap(({ name, items }) => items.filter((each) => each.stop >= start && each.start <= stop).map((each) => ({ name, ...each })));
  const rows = all.sort((one, other) => one.start - other.start).slice(0, most).map((each) =>
    element("tr", {}, [utc(each.start * 1000), utc(each.stop * 1000), words(`views.history.lane.${each.name}`), each.text].map((text) => element("td", {}, text))),
  );
  const head = ["start", "stop", "lane", "what"].map((key) => element("th", { scope: "col" }, words(`views.history.column.${key}`)));
  return fill(element("table", {}), element("caption", {}, words("views.history.events")), element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows));
}
