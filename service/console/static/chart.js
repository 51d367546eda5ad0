/**
 * @file Curves: panels one above the other on one cursor and one span of time. The only module that knows uPlot.
 *
 * uPlot is served only where its files are those that were examined; without it `canDraw` says so, and the caller shows
 * a table.
 */

import { element, fill } from "./element.js";
import { number, utc } from "./words.js";

/** Room of the axis left of each panel, px; what stands beside the panels keeps it too. */
export const LEFT_PX = 84;
export const RIGHT_PX = 24;
const AXIS_PX = 26;
const HOUR_S = 3600;
const DAY_S = 86400;
const WHEEL_ZOOM = 1.25;
const WHEEL_PAN = 0.1;
/** A selection that is narrower is a click. */
const LEAST_DRAG_PX = 5;

let asked = null;

/** Load uPlot once. @returns {Promise<boolean>} Whether curves can be drawn. */
export function canDraw() {
  asked ??= new Promise((resolve) => {
    const script = element("script", { src: "uplot.js", onload: () => resolve("uPlot" in window), onerror: () => resolve(false) });
    document.head.append(element("link", { rel: "stylesheet", href: "uplot.css" }), script);
  });
  return asked;
}

/**
 * @typedef {Object} Panel
 * @property {string} title
 * @property {{name: string, values: (number | null)[], tone: string, isDashed?: boolean}[]} lines `tone` is a token of colour.
 * @property {{low: (number | null)[], high: (number | null)[], tone: string, share: number}[]} bands `share`: how opaque.
 * @property {{value: number, tone: string}[]} limits
 */

/**
 * Return a stack of panels, to be filled by `draw`.
 * @param {{label: string, panels: number, height: number, onRange: (start: number, stop: number) => void, onSelect?: (start: number, stop: number) => void, onCursor: (index: number | null) => void}} given
 *   `onRange` hears of every wish for another span, s since 1970, `onSelect` in its place of what is dragged; `onCursor`
 *   the index of the row under the cursor.
 */
export function stack({ label, panels: count, height, onRange, onSelect = onRange, onCursor }) {
  const hosts = Array.from({ length: count }, () => element("div", { class: "panel" }));
  const node = element("div", { class: "chart", role: "img", "aria-label": label }, hosts);
  const key = Symbol(label).toString() + performance.now();
  let plots = [];
  let shape = "";
  let range = [0, 1];
  let limits = [];
  let isClosed = false;

  const width = () => Math.max(node.clientWidth, LEFT_PX + RIGHT_PX + 50);
  const resized = new ResizeObserver(() => plots.forEach((plot) => plot.setSize({ width: width(), height: plot.height })));
  resized.observe(node);
  const recoloured = new MutationObserver(() => plots.forEach((plot) => plot.redraw(false)));
  recoloured.observe(document.documentElement, { attributeFilter: ["data-theme"] });

  function wheel(plot, event) {
    event.preventDefault();
    const [start, stop] = range;
    const isPan = event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY);
    if (isPan) {
      const by = Math.sign(event.deltaX || event.deltaY) * WHEEL_PAN * (stop - start);
      onRange(start + by, stop + by);
      return;
    }
    const centre = plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x");
    const factor = event.deltaY > 0 ? WHEEL_ZOOM : 1 / WHEEL_ZOOM;
    onRange(centre - (centre - start) * factor, centre + (stop - centre) * factor);
  }

  function selected(plot) {
    const { left, width: size } = plot.select;
    if (size === 0) return;
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (size >= LEAST_DRAG_PX) onSelect(plot.posToVal(left, "x"), plot.posToVal(left + size, "x"));
  }

  function made(panel, index, data) {
    const isLast = index === count - 1;
    const options = {
      width: width(),
      height: height + (isLast ? AXIS_PX : 0),
      tzDate: (seconds) => window.uPlot.tzDate(new Date(seconds * 1000), "Etc/UTC"),
      legend: { show: false },
      padding: [8, RIGHT_PX, 8, 0],
      scales: { x: { time: true, range: () => range }, y: { range: (_, low, high) => around(low, high, limits[index]) } },
      axes: [{ ...lines(), size: isLast ? AXIS_PX : 0, values: isLast ? instants : () => [], space: 90 }, { ...lines(), size: LEFT_PX, values: (_, ticks) => ticks.map(tickText) }],
      series: [{}, ...seriesOf(panel)],
      bands: panel.bands.map((band, position) => ({ series: [2 * position + 1, 2 * position + 2], fill: () => faded(band.tone, band.share) })),
      cursor: { drag: { x: true, y: false, setScale: false }, y: false, sync: { key, setSeries: false, filters: { pub: (kind) => kind === "mousemove" || kind === "mouseleave" } } },
      hooks: {
        setSelect: [selected],
        setCursor: [(plot) => plot.cursor.event && onCursor(plot.cursor.left < 0 ? null : (plot.cursor.idx ?? null))],
        draw: [(plot) => drawLimits(plot, limits[index])],
        ready: [(plot) => plot.over.addEventListener("wheel", (event) => wheel(plot, event), { passive: false })],
      },
    };
    return new window.uPlot(options, data, fill(hosts[index]));
  }

  return {
    node,
    /**
     * Draw rows.
     * @param {number[]} epochs s since 1970, ascending. @param {Panel[]} panels As many as there are hosts. @param {[number, number]} span
     */
    draw(epochs, panels, span) {
      // a view stands on the page until the next one is loaded: what is drawn into it now would never be destroyed
      if (isClosed) return;
      range = span;
      limits = panels.map((panel) => panel.limits);
      const data = panels.map((panel) => [epochs, ...panel.bands.flatMap(({ high, low }) => [high, low]), ...panel.lines.map(({ values }) => values)]);
      const wanted = JSON.stringify(panels.map((panel) => [panel.bands.map(({ tone, share }) => [tone, share]), panel.lines.map(({ tone, isDashed }) => [tone, isDashed])]));
      if (wanted === shape) plots.forEach((plot, index) => plot.setData(data[index]));
      else {
        plots.forEach((plot) => plot.destroy());
        plots = panels.map((panel, index) => made(panel, index, data[index]));
        shape = wanted;
      }
    },
    /** Show another span of the rows that are there. @param {[number, number]} span */
    setRange(span) {
      range = span;
      for (const plot of plots) plot.setScale("x", { min: span[0], max: span[1] });
    },
    close() {
      isClosed = true;
      resized.disconnect();
      recoloured.disconnect();
      plots.forEach((plot) => plot.destroy());
      plots = [];
    },
  };
}

function seriesOf({ bands, lines: shown }) {
  const edge = { stroke: null, width: 0, points: { show: false } };
  const curves = shown.map(({ tone, isDashed }) => ({ stroke: () => token(tone), width: 1.5, dash: isDashed ? [6, 4] : undefined, points: { size: 4, fill: () => token(tone) } }));
  return [...bands.flatMap(() => [edge, edge]), ...curves];
}

/** Return the ends of an axis: the values with some room, and the least limits once the values come near. */
function around(low, high, limits) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [-1, 1];
  const size = Math.max(Math.abs(low), Math.abs(high));
  const near = limits.map(({ value }) => value).filter((value) => Math.abs(value) < 2 * size);
  const [least, greatest] = [Math.min(low, ...near), Math.max(high, ...near)];
  const room = Math.max(0.06 * (greatest - least), 0.002);
  return [least - room, greatest + room];
}

function drawLimits(plot, limits) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.setLineDash([2, 4]);
  ctx.lineWidth = 1.5 * devicePixelRatio;
  for (const { value, tone } of limits) {
    const y = plot.valToPos(value, "y", true);
    ctx.strokeStyle = token(tone);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.restore();
}

/** Return a number with as many digits as it has. */
function tickText(tick) {
  const rounded = Number(tick.toPrecision(6));
  return number(rounded, String(rounded).split(".")[1]?.length ?? 0);
}

/** Return texts of instants: as much of date and time as the distance of the ticks needs. */
function instants(_plot, ticks, _axis, _space, step) {
  return ticks.map((tick) => {
    const isMidnight = tick % DAY_S === 0;
    if (step >= DAY_S || (isMidnight && step >= HOUR_S)) return utc(tick * 1000, "date");
    return utc(tick * 1000, step < 60 ? "time" : "minute");
  });
}

function lines() {
  const grid = { stroke: () => faded("line", 0.5), width: 1 };
  return { stroke: () => token("quiet"), grid, ticks: { ...grid, size: 4 }, font: "12px sans-serif" };
}

function token(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Return a token's colour, which is written as #rgb or #rrggbb, with less than full cover. */
function faded(name, share) {
  const colour = token(name);
  const long = colour.length === 4 ? colour.replace(/[0-9a-f]/gi, "$&$&") : colour;
  return long + Math.round(255 * share).toString(16).padStart(2, "0");
}
