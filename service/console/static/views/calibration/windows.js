/** @file Windows of a calibration and an alignment: dragged over readings of the sensors and operations, or written. */

import { get } from "../../api.js";
import { LEFT_PX, RIGHT_PX, canDraw, stack } from "../../chart.js";
import { element, fill, onFrame, setText } from "../../element.js";
import { instantInput, instantMs, writeInstant } from "../../lists/instant_input.js";
import { choice } from "../../lists/table.js";
import { presentOf } from "../../parts/header.js";
import { drawnLanes, lanesOf } from "../../parts/lanes.js";
import { duration, utc, words } from "../../words.js";
import { AXES, SENSORS, axisWords, chooser, sayProblem, w } from "./report.js";

const WINDOWS = ["quiet", "turns", "alignment"];
/** Of the timeline: what a window should hold, or avoid. */
const LANES = ["operations", "gaps", "fade", "marks"];
const FIRST_SPAN_S = 4 * 86_400;
const LEAST_SPAN_S = 600;
const GREATEST_SPAN_S = 400 * 86_400;
/** The service warns of shorter quiet days: slow noise is hardly seen in them. */
const SHORT_QUIET = "SOO_CALIBRATION__SHORT_QUIET_DAYS";
const PAGE_ROWS = 10_000;
const MOST_PAGES = 3;
const PANEL_PX = 110;
/** Windows that are dragged begin and end with a minute. */
const GRID_S = 60;
const SETTLE_MS = 150;
/** Readings farther apart than so many usual distances are not joined by a line. */
const GAP_FACTOR = 10;

const secondsOf = (epoch) => Date.parse(epoch) / 1000;
const iso = (seconds) => new Date(Math.round(seconds * 1000)).toISOString();

/** @param {{store: any, path: string, mayOperate: boolean}} given `path` of the spacecraft; who may not operate looks. */
export function windowPlot({ store, path, mayOperate }) {
  const windows = Object.fromEntries(WINDOWS.map((name) => [name, [NaN, NaN]]));
  let dragged = mayOperate ? WINDOWS[0] : "zoom";
  let span = [0, 1];
  let rows = [];
  let timeline = null;
  let isCut = false;
  let settling = 0;
  let shortS = NaN;
  let asking = new AbortController();

  const status = element("p", { class: "history-status", role: "status" });
  const problem = element("div");
  const lanes = element("div", { class: "lanes" });
  const marks = element("div", { class: "marks", style: { left: `${LEFT_PX}px`, right: `${RIGHT_PX}px` } });
  const sensors = Object.fromEntries(AXES.map((axis) => [axis, chooser(w("sensorOf", { axis: axisWords(axis) }), SENSORS, "sensor", () => draw())]));
  const fields = Object.fromEntries(WINDOWS.map((name) => [name, windowFields(name)]));
  const chart = stack({
    label: w("chart"),
    panels: AXES.length,
    height: PANEL_PX,
    onRange: (start, stop) => look(start, stop),
    onSelect: (start, stop) => (dragged === "zoom" ? look(start, stop) : choose(dragged, [start, stop].map((end) => Math.round(end / GRID_S) * GRID_S))),
    onCursor: () => {},
  });
  const button = (key, onclick) => element("button", { type: "button", onclick }, words(`views.history.${key}`));
  const names = AXES.map((axis) => element("h2", {}, words("views.history.panel", { axis: axisWords(axis) })));
  const plot = element("div", { class: "panels", style: { "--left": `${LEFT_PX}px`, "--panel": `${PANEL_PX}px` } }, element("div", { class: "panel-names" }, names), chart.node, marks);
  const node = element("div", { class: "history windows", "aria-busy": "true" },
    element("div", { class: "toolbar", role: "toolbar", "aria-label": w("drag") },
      mayOperate && [element("span", {}, w("drag")), choice(w("drag"), [...WINDOWS, "zoom"].map((name) => [name, w(`window.${name}`)]), (name) => (dragged = name))],
      button("earlier", () => move(-0.5, -0.5)), button("later", () => move(0.5, 0.5)), button("closer", () => move(0.25, -0.25)), button("wider", () => move(-0.5, 0.5)),
      element("button", { type: "button", onclick: begin }, w("newest"))),
    element("div", { class: "toolbar" }, AXES.map((axis) => element("span", {}, w("sensorOf", { axis: axisWords(axis) }), " ", sensors[axis]))),
    problem, status, element("div", { class: "plots" }, plot, lanes),
  );

  function windowFields(name) {
    const ends = [0, 1].map((end) => instantInput({ required: true, "aria-label": w(end ? "stopOf" : "startOf", { window: w(`window.${name}`) }), oninput: () => write(end) }));
    const said = element("span", { class: "detail" });
    const declared = name === "turns" && element("button", { type: "button", onclick: takeDeclared }, w("declared"));
    function write(end) {
      windows[name][end] = instantMs(ends[end]) / 1000;
      show();
    }
    function show() {
      const length = windows[name][1] - windows[name][0];
      const isShort = name === "quiet" && length < shortS;
      setText(said, length > 0 ? [duration(length), isShort && w("short", { length: duration(shortS) })].filter(Boolean).join("; ") : "");
      drawMarks();
    }
    return {
      declared,
      show,
      node: element("p", { class: "field" }, element("span", { class: "window-name" }, w(`window.${name}`)), ends[0], " – ", ends[1], w("utc"), declared, said),
      /** Write a window that was dragged. */
      fill() {
        ends.forEach((input, end) => writeInstant(input, windows[name][end] * 1000));
        show();
      },
    };
  }

  function choose(name, ends) {
    windows[name] = ends;
    fields[name].fill();
  }

  const declaredTurns = () => (timeline?.operations ?? []).filter(({ kind, stop }) => kind === "calibration_turn" && stop);

  /** Choose the window from the first declared turn that is shown to the end of the last. */
  function takeDeclared() {
    const turns = declaredTurns();
    choose("turns", [Math.min(...turns.map(({ start }) => secondsOf(start))), Math.max(...turns.map(({ stop }) => secondsOf(stop)))]);
  }

  function drawMarks() {
    const size = span[1] - span[0];
    fill(marks, WINDOWS.map((name) => {
      const [left, right] = windows[name].map((end) => Math.min(Math.max((end - span[0]) / size, 0), 1));
      return right > left && element("div", { class: `mark ${name}`, style: { left: `${100 * left}%`, width: `${100 * (right - left)}%` } }, element("span", {}, w(`window.${name}`)));
    }));
  }

  function drawLanes() {
    const all = timeline ? lanesOf(timeline, "robust", presentS()) : [];
    fill(lanes, drawnLanes(all.filter(({ name }) => LANES.includes(name)), span, lanes.clientWidth));
    fields.turns.declared.disabled = declaredTurns().length === 0;
  }

  const presentS = () => {
    const present = presentOf(store.get());
    return (Number.isFinite(present) ? present : Date.now() + store.get().offsetMs) / 1000;
  };

  const draw = onFrame(async () => {
    const isDrawn = await canDraw();
    if (!timeline || !node.isConnected) return;
    plot.hidden = !isDrawn;
    const [epochs, ...readings] = columnsOf(rows, sensors, span);
    if (isDrawn) chart.draw(epochs, AXES.map((axis, k) => ({ title: axisWords(axis), lines: [{ name: axis, values: readings[k], tone: "text" }], bands: [], limits: [] })), span);
    drawLanes();
    drawMarks();
    setText(status, statusText(isDrawn));
  });

  function statusText(isDrawn) {
    const counts = SENSORS.map((sensor) => [sensor, rows.filter(({ source }) => source === sensor).length]).filter(([, count]) => count > 0);
    return [
      words("views.history.spanText", { start: utc(span[0] * 1000), stop: utc(span[1] * 1000), length: duration(span[1] - span[0]) }),
      counts.length > 0 ? counts.map(([sensor, count]) => w("readings", { sensor: w(`sensor.${sensor}`), count })).join(", ") : w("noReadings"),
      isCut && w("cut", { count: rows.length }),
      !isDrawn && words("views.history.noCurves"),
    ].filter(Boolean).join(". ");
  }

  function look(start, stop) {
    const size = Math.min(Math.max(stop - start, LEAST_SPAN_S), GREATEST_SPAN_S);
    span = [(start + stop - size) / 2, (start + stop + size) / 2];
    chart.setRange(span);
    drawMarks();
    drawLanes();
    clearTimeout(settling);
    settling = setTimeout(load, SETTLE_MS);
  }

  /** Look at a span whose ends are moved by shares of the present one. */
  function move(first, last) {
    const size = span[1] - span[0];
    look(span[0] + first * size, span[1] + last * size);
  }

  /** Ask, and show the answer or why there is none; what is asked later has the word. */
  async function ask(act, again) {
    asking.abort();
    asking = new AbortController();
    const { signal } = asking;
    node.setAttribute("aria-busy", "true");
    setText(status, words("views.history.loading"));
    try {
      await act(signal);
      fill(problem);
    } catch (error) {
      if (signal.aborted) return;
      sayProblem(problem, error, again);
      setText(status, words("views.history.failed"));
    }
    if (!signal.aborted) node.setAttribute("aria-busy", "false");
  }

  const load = () => ask(read, load);

  async function read(signal) {
    const ends = { start: iso(span[0]), stop: iso(span[1]) };
    const [found, answer] = await Promise.all([referencesOf(path, ends, signal), get(`${path}/timeline`, ends, { signal })]);
    [rows, isCut, timeline] = [found.rows, found.isCut, answer];
    draw();
  }

  /** Show the newest readings, as far back as readings go. */
  function begin() {
    return ask(async (signal) => {
      const ends = await Promise.all(["asc", "desc"].map((order) => get(`${path}/attitude-references`, { order, limit: 1 }, { signal })));
      const [oldest, newest] = ends.map((page) => page.rows[0]);
      const stop = newest ? secondsOf(newest.epoch) : presentS();
      const start = oldest ? Math.max(secondsOf(oldest.epoch), stop - FIRST_SPAN_S) : stop - FIRST_SPAN_S;
      // room to drag beyond the ends
      const room = Math.max(0.02 * (stop - start), LEAST_SPAN_S / 2);
      if (newest && rows.length === 0) for (const axis of AXES) sensors[axis].value = newest.source;
      span = [start - room, stop + room];
      await read(signal);
    }, begin);
  }

  get("/about").then(({ settings }) => {
    shortS = 86_400 * Number(settings?.find((each) => each.name === SHORT_QUIET)?.value);
    fields.quiet.show();
  }, () => {});
  const resized = new ResizeObserver(onFrame(drawLanes));
  resized.observe(lanes);
  begin();
  return {
    node,
    fieldsOf: (name) => fields[name].node,
    windowOf: (name) => ({ start: iso(windows[name][0]), stop: iso(windows[name][1]) }),
    sources: () => Object.fromEntries(AXES.map((axis) => [axis, sensors[axis].value])),
    close() {
      asking.abort();
      clearTimeout(settling);
      resized.disconnect();
      chart.close();
    },
  };
}

/** Read the references of a span, up to some pages. */
async function referencesOf(path, ends, signal) {
  const rows = [];
  let cursor = null;
  for (let page = 0; page < MOST_PAGES; page += 1) {
    const answer = await get(`${path}/attitude-references`, { ...ends, limit: PAGE_ROWS, cursor }, { signal });
    rows.push(...answer.rows);
    cursor = answer.next;
    if (!cursor) break;
  }
  return { rows, isCut: Boolean(cursor) };
}

/** Return epochs and, of each axis, readings of its sensor; null is a gap, undefined an epoch of another sensor. */
function columnsOf(rows, sensors, span) {
  const columns = new Map();
  const put = (epoch, k, value) => {
    if (!columns.has(epoch)) columns.set(epoch, AXES.map(() => undefined));
    columns.get(epoch)[k] = value;
  };
  AXES.forEach((axis, k) => {
    const own = rows.filter((row) => row.source === sensors[axis].value && Number.isFinite(row[`${axis}_deg`]));
    const at = own.map(({ epoch }) => secondsOf(epoch));
    const usual = at.slice(1).map((epoch, n) => epoch - at[n]).sort((one, other) => one - other)[(at.length - 1) >> 1];
    at.forEach((epoch, n) => {
      if (n > 0 && epoch - at[n - 1] > GAP_FACTOR * usual) put((epoch + at[n - 1]) / 2, k, null);
      put(epoch, k, own[n][`${axis}_deg`]);
    });
    // the ends of the span are there without readings too, so that a drag finds its instants
    for (const end of span) if (!columns.has(end)) put(end, k, null);
  });
  const epochs = [...columns.keys()].sort((one, other) => one - other);
  return [epochs, ...AXES.map((_, k) => epochs.map((epoch) => columns.get(epoch)[k]))];
}
