/** @file History: where the satellite pointed, by both methods and smoothed, and what happened beside it, from minutes to years. */

import { AXES, address, get } from "../api.js";
import { LEFT_PX, canDraw, stack } from "../chart.js";
import { element, fill, onFrame, setText } from "../element.js";
import { soon } from "../lists/newest_first.js";
import { QUANTITIES, SMOOTHED, curveTable, curvesOf, isEnvelope, legendOf, panelsOf, readingOf, renewed } from "../parts/curves.js";
import { presentOf } from "../parts/header.js";
import { drawnLanes, laneTable, lanesOf } from "../parts/lanes.js";
import { failure } from "../parts/problem.js";
import { duration, utc, words } from "../words.js";

export const name = "history";

const SPANS_S = { hour: 3600, quarter: 21_600, day: 86_400, week: 604_800, month: 2_592_000, year: 31_622_400 };
const FORMATS = ["csv", "ndjson", "parquet", "aem"];
const LEAST_SPAN_S = 60;
const GREATEST_SPAN_S = 100 * SPANS_S.year;
/** Intervals asked for; a table shows fewer. */
const INTERVALS = 600;
const TABLE_ROWS = 60;
const EVENT_ROWS = 200;
const PANEL_PX = 140;
/** A wish for another span is asked for when no other follows it within this. */
const SETTLE_MS = 60;
const TAIL_INTERVALS = 5;
const TAIL_MS = 1000;
/** Lanes of a live span are asked for again. */
const TIMELINE_MS = 30_000;
const ZOOM = 1.5;
const PAN = 0.25;

/** @param {{store: any, spacecraft: any, parameters: URLSearchParams, rewrite: (parameters: Object<string, string>) => void}} context */
export function show({ store, spacecraft, parameters, rewrite }) {
  const base = `/spacecraft/${spacecraft.id}`;
  const first = spanOf(parameters);
  let { span, isLive } = first;
  let curves = null;
  let timeline = null;
  let limits = [];
  let isTable = parameters.get("as") === "table";
  let isSmoothed = parameters.get("smoothed") !== "0";
  let asking = new AbortController();
  let settling = 0;
  let tailing = 0;
  let timelineAt = 0;
  let cursor = null;
  /** Of each drawn row its interval, -1 of a gap. */
  let places = [];

  const status = element("p", { class: "history-status", role: "status" });
  const heading = element("h1", {});
  const reading = element("p", { class: "reading" });
  const legend = element("p", { class: "legend" });
  const problem = element("div", {});
  const lanes = element("div", { class: "lanes" });
  const tables = element("div", { class: "history-tables" });
  const exported = ["robust", "paper", SMOOTHED.method].flatMap((method) => FORMATS.map((format) => ({ method, format, link: element("a", { download: "" }, words("views.history.exportOf", { method: words(`views.history.method.${method}`), format })) })));
  const links = element("p", { class: "exports" }, words("views.history.export"), exported.map(({ link }) => link));
  const liveButton = button("live", () => follow(span[1] - span[0]));
  const tableButton = switched("table", isTable, (isOn) => ((isTable = isOn), draw(), write()));
  const smoothedButton = switched("smoothed", isSmoothed, (isOn) => ((isSmoothed = isOn), load()));
  const chart = stack({
    label: words("views.history.chart"),
    panels: AXES.length,
    height: PANEL_PX,
    onRange: (start, stop) => look([start, stop]),
    onCursor: (index) => {
      cursor = index;
      setText(reading, readingText());
    },
  });
  const plots = element("div", { class: "plots", tabIndex: 0, role: "group", "aria-label": words("views.history.keys"), onkeydown: onKey }, titled(chart.node), lanes);
  const node = element("section", { class: "history", "aria-label": words("views.history.title"), "aria-busy": "true" },
    element("div", { class: "history-head" }, heading, status),
    element("div", { class: "toolbar", role: "toolbar", "aria-label": words("views.history.tools") },
      Object.entries(SPANS_S).map(([key, size]) => button(`span.${key}`, () => choose(size))), button("earlier", () => pan(-PAN)),
      button("later", () => pan(PAN)), button("closer", () => zoom(1 / ZOOM)), button("wider", () => zoom(ZOOM)), liveButton, smoothedButton, tableButton,
    ),
    first.isBad && element("p", { class: "notice", role: "alert" }, words("views.history.badSpan")), problem,
    element("div", { class: "history-head" }, legend, reading), plots, links, tables,
  );

  const methods = () => (store.get().status?.method === "paper" ? ["paper", "robust"] : ["robust", "paper"]);
  const shown = () => (isSmoothed ? [...methods(), SMOOTHED.method] : methods());
  /** The service's present, s; a row may be newer than the last status. */
  const present = () => {
    const { attitude, offsetMs } = store.get();
    const known = [presentOf(store.get()), ...Object.values(attitude).map((row) => Date.parse(row.epoch))].filter(Number.isFinite);
    return (known.length > 0 ? Math.max(...known) : Date.now() + offsetMs) / 1000;
  };
  const iso = (seconds) => new Date(Math.round(seconds * 1000)).toISOString();
  // the end of a request is exclusive, the present is not
  const ends = () => ({ start: iso(span[0]), stop: iso(span[1] + (isLive ? 1 : 0)) });

  function button(key, onclick) {
    return element("button", { type: "button", onclick }, words(`views.history.${key}`));
  }

  function switched(key, isOn, change) {
    const made = button(key, () => {
      made.setAttribute("aria-pressed", String((isOn = !isOn)));
      change(isOn);
    });
    made.setAttribute("aria-pressed", String(isOn));
    return made;
  }

  /** Look at a span, which is no longer live. */
  function look([start, stop]) {
    const size = Math.min(Math.max(stop - start, LEAST_SPAN_S), GREATEST_SPAN_S);
    const centre = (start + stop) / 2;
    isLive = false;
    move([centre - size / 2, centre + size / 2]);
  }

  /** Look at the newest rows, and go on with them. */
  function follow(size) {
    isLive = true;
    move([present() - size, present()]);
  }

  function choose(size) {
    if (isLive) follow(size);
    else look([(span[0] + span[1] - size) / 2, (span[0] + span[1] + size) / 2]);
  }

  function pan(share) {
    const by = share * (span[1] - span[0]);
    look([span[0] + by, span[1] + by]);
  }

  function zoom(factor) {
    const half = ((span[1] - span[0]) * factor) / 2;
    if (isLive) follow(2 * half);
    else look([(span[0] + span[1]) / 2 - half, (span[0] + span[1]) / 2 + half]);
  }

  function onKey(event) {
    const acts = { ArrowLeft: () => pan(-PAN), ArrowRight: () => pan(PAN), "+": () => zoom(1 / ZOOM), "=": () => zoom(1 / ZOOM), "-": () => zoom(ZOOM), Home: () => follow(span[1] - span[0]) };
    if (event.altKey || event.ctrlKey || event.metaKey || !(event.key in acts)) return;
    event.preventDefault();
    acts[event.key]();
  }

  /** Show a span at once in what is there, and ask for it. */
  function move(wanted) {
    span = wanted;
    write();
    node.setAttribute("aria-busy", "true");
    chart.setRange(span);
    drawLanes();
    clearTimeout(settling);
    settling = setTimeout(load, SETTLE_MS);
    setText(status, words("views.history.loading"));
  }

  /** Write the span into the address and its links, without a step in the history of the browser. */
  function write() {
    const named = isLive ? { span: String(Math.round(span[1] - span[0])) } : ends();
    rewrite({ ...named, ...(isTable && { as: "table" }), ...(!isSmoothed && { smoothed: "0" }) });
    setText(heading, words("views.history.spanText", { start: utc(span[0] * 1000), stop: utc(span[1] * 1000), length: duration(span[1] - span[0]) }));
    liveButton.disabled = isLive;
    for (const { link, method, format } of exported) link.href = address(`${base}/archive/attitude:export`, { format, method, version: method === SMOOTHED.method ? SMOOTHED.version : null, ...ends() });
  }

  async function load() {
    asking.abort();
    asking = new AbortController();
    const { signal } = asking;
    clearTimeout(tailing);
    tailing = 0;
    node.setAttribute("aria-busy", "true");
    setText(status, words("views.history.loading"));
    if (isLive) span = [present() - (span[1] - span[0]), present()];
    write();
    try {
      const [samples, smoothed, found] = await Promise.all([ask(ends(), INTERVALS, signal), isSmoothed && ask(ends(), INTERVALS, signal, SMOOTHED), askTimeline(signal)]);
      curves = curvesOf(samples, smoothed);
      timeline = found;
      timelineAt = performance.now();
      fill(problem);
      draw();
    } catch (error) {
      if (signal.aborted) return;
      fill(problem, failure(error), button("again", load));
      setText(status, words("views.history.failed"));
    }
    node.setAttribute("aria-busy", "false");
  }

  const ask = (window_, count, signal, of = { quantity: QUANTITIES, method: methods() }) => get(`${base}/samples`, { ...window_, ...of, count, extreme_epochs: false }, { signal });
  // lanes are those of the driving method, and the rows of both stand beside each other
  const askTimeline = (signal) => get(`${base}/timeline`, { ...ends(), method: methods()[0] }, { signal });

  /** Ask for what is new of a live span: whole intervals again, so that no row is missing and none is twice. */
  async function tail() {
    tailing = 0;
    if (!isLive || !curves || node.getAttribute("aria-busy") === "true") return;
    const { signal } = asking;
    const { interval } = curves;
    const [newest, stop] = [curves.epochs.at(-1), Math.ceil(present() / interval) * interval + interval];
    if (newest === undefined || stop - newest > TAIL_INTERVALS * interval + INTERVALS * interval) return void load();
    try {
      const since = newest - interval;
      const answer = await ask({ start: iso(since), stop: iso(stop) }, Math.round((stop - since) / interval), signal);
      if (signal.aborted || answer.interval_s !== interval) return void (signal.aborted || load());
      curves = renewed(curves, curvesOf(answer), since);
      const size = span[1] - span[0];
      span = [present() - size, present()];
      write();
      if (performance.now() - timelineAt > TIMELINE_MS) {
        timelineAt = performance.now();
        timeline = await askTimeline(signal);
      }
      draw();
    } catch {
      // the stream says that the service is away, and calls again when it is back
    }
  }

  const onRow = () => {
    if (isLive) tailing ||= setTimeout(tail, Math.max(TAIL_MS, Math.min(curves?.interval ?? 0, 60) * 100));
  };

  const draw = onFrame(async () => {
    if (!curves || !node.isConnected) return;
    const isDrawn = !isTable && (await canDraw());
    chart.node.parentElement.hidden = !isDrawn;
    if (isDrawn) {
      const drawn = panelsOf(curves, { gaps: timeline.gaps, methods: shown(), limits });
      places = drawn.places;
      chart.draw(drawn.epochs, drawn.panels, span);
    }
    drawLanes();
    fill(tables, !isDrawn && [curveTable(curves, shown(), TABLE_ROWS), laneTable(allLanes(), span, EVENT_ROWS)]);
    setText(status, statusText(isDrawn));
    setText(reading, readingText());
    fill(legend, legendOf(shown(), isEnvelope(curves)));
    node.dataset.rows = String(curves.epochs.length);
  });

  const allLanes = () => lanesOf(timeline, methods()[0], present());

  function drawLanes() {
    if (timeline) fill(lanes, drawnLanes(allLanes(), span, lanes.clientWidth));
  }

  function statusText(isDrawn) {
    const said = [
      isLive && words("views.history.isLive"),
      words("views.history.interval", { length: duration(curves.interval) }),
      curves.epochs.length === 0 && words("views.history.empty"),
      isEnvelope(curves) && words("views.history.envelope"),
      timeline.joined_s > 0 && words("views.history.joined", { length: duration(timeline.joined_s) }),
      timeline.states_left_out.length > 0 && words("views.history.leftOut", { spans: timeline.states_left_out.map(({ start, stop }) => `${utc(start)} – ${utc(stop)}`).join(", ") }),
      timeline.cut.length > 0 && words("views.history.cut", { lists: timeline.cut.map((each) => words(`views.history.list.${each}`)).join(", ") }),
      !isDrawn && !isTable && words("views.history.noCurves"),
    ];
    return said.filter(Boolean).join(" ");
  }

  const readingText = () => (curves ? readingOf(curves, cursor === null ? curves.epochs.length - 1 : places[cursor], shown()) : "");

  async function readLimits() {
    try {
      const { conditions } = await get(`${base}/alarm-limits/in-force`);
      const angle = conditions.attitude_angle ?? {};
      limits = [["warning", "caution"], ["critical", "critical"]].flatMap(([severity, tone]) => {
        const value = angle[severity];
        return Number.isFinite(value) ? [{ value, tone }, { value: -value, tone }] : [];
      });
      draw();
    } catch {
      // curves are shown without them
    }
  }

  const resized = new ResizeObserver(onFrame(drawLanes));
  resized.observe(lanes);
  const finish = [
    store.on("attitude", onRow),
    store.on("smoothed", soon(() => isLive && load())),
    store.on("dropped", () => isLive && load()),
    store.subscribe((state) => state.link.state, (state) => state === "live" && isLive && load()),
    store.subscribe((state) => state.status?.method, () => (write(), load())),
  ];
  if (span === null) span = [present() - first.size, present()];
  write();
  setText(status, words("views.history.loading"));
  load();
  readLimits();
  return {
    node,
    close() {
      asking.abort();
      clearTimeout(settling);
      clearTimeout(tailing);
      resized.disconnect();
      finish.forEach((end) => end());
      chart.close();
    },
  };
}

/** Return panels with the name of each axis beside it. */
function titled(chart) {
  const names = AXES.map((axis) => element("h2", {}, words("views.history.panel", { axis: words(`app.axis.${axis}`) })));
  return element("div", { class: "panels", style: { "--left": `${LEFT_PX}px`, "--panel": `${PANEL_PX}px` } }, element("div", { class: "panel-names" }, names), chart);
}

/** Return the span that an address names: fixed ends, or a live one; the last six hours where it names none or a bad one. */
function spanOf(parameters) {
  const [start, stop] = ["start", "stop"].map((end) => Date.parse(parameters.get(end) ?? "") / 1000);
  if (stop - start >= LEAST_SPAN_S && stop - start <= GREATEST_SPAN_S) return { span: [start, stop], isLive: false };
  const size = Number(parameters.get("span"));
  const isGood = size >= LEAST_SPAN_S && size <= GREATEST_SPAN_S;
  const isBad = !isGood && ["start", "stop", "span"].some((each) => parameters.has(each));
  return { span: null, isLive: true, size: isGood ? size : SPANS_S.quarter, isBad };
}
