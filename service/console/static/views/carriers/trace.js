/** @file Small curves as SVG: lines, a band around a line, breaks where there is nothing. */

import { svg } from "../../element.js";
import { number, utc } from "../../words.js";

/** Heights that lie closer than this are drawn as one level, dB. */
const LEAST_SPAN = 0.2;

/**
 * @typedef {Object} Line
 * @property {(number | null)[]} values
 * @property {string} kind Class of the line: level, model, residual.
 *
 * @typedef {Object} Trace
 * @property {string} label What it shows, in words.
 * @property {number[]} epochs Milliseconds, ascending.
 * @property {number} start
 * @property {number} stop
 * @property {number} intervalMs
 * @property {Line[]} lines
 * @property {{low: (number | null)[], high: (number | null)[]}[]} [bands]
 * @property {boolean} [isFramed] With scales at its sides.
 * @property {number} [width]
 * @property {number} [height]
 * @property {number | null} [zero] A level that is marked.
 */

/** Return a curve. @param {Trace} drawn */
export function trace(drawn) {
  const { label, epochs, start, stop, lines, bands = [], isFramed = false, width = 160, height = 40, zero = null } = drawn;
  const frame = isFramed ? { left: 56, right: 8, top: 8, bottom: 22 } : { left: 1, right: 1, top: 2, bottom: 2 };
  const held = [...lines.flatMap(({ values }) => values), ...bands.flatMap(({ low, high }) => [...low, ...high]), zero].filter(Number.isFinite);
  const [least, greatest] = held.length ? [held.reduce((a, b) => Math.min(a, b)), held.reduce((a, b) => Math.max(a, b))] : [0, 1];
  const room = Math.max(0, LEAST_SPAN - (greatest - least)) / 2;
  const [low, high] = [least - room, greatest + room];
  const x = (epoch) => frame.left + ((width - frame.left - frame.right) * (epoch - start)) / Math.max(1, stop - start);
  const y = (value) => frame.top + ((height - frame.top - frame.bottom) * (high - value)) / Math.max(1e-9, high - low);
  // the middle of an interval
  const xs = epochs.map((epoch) => x(epoch + drawn.intervalMs / 2));
  const gapMs = 2.5 * Math.max(drawn.intervalMs, spacingOf(epochs));
  const runs = (values) => runsOf(values, epochs, gapMs);
  return svg("svg", { class: "trace", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label },
    isFramed && scales({ low, high, start, stop, width, height, frame, x, y }),
    bands.map((band) => runs(band.low).map((run) => svg("path", { class: "band", d: ring(run, band, xs, y) }))),
    zero !== null && svg("line", { class: "zero", x1: frame.left, x2: width - frame.right, y1: y(zero), y2: y(zero) }),
    lines.map(({ values, kind }) => runs(values).map((run) => svg("path", { class: `line ${kind}`, d: path(run, values, xs, y) }))),
  );
}

/** Return the usual distance of epochs: rows may come more rarely than intervals. */
function spacingOf(epochs) {
  const steps = epochs.slice(1).map((epoch, k) => epoch - epochs[k]);
  return steps.sort((a, b) => a - b)[Math.floor(steps.length / 2)] ?? 0;
}

/** Return the positions of values that follow each other without a gap. */
function runsOf(values, epochs, gapMs) {
  const runs = [];
  values.forEach((value, k) => {
    if (!Number.isFinite(value)) return;
    const last = runs.at(-1);
    if (last && last.at(-1) === k - 1 && epochs[k] - epochs[k - 1] <= gapMs) last.push(k);
    else runs.push([k]);
  });
  return runs;
}

function path(run, values, xs, y) {
  const points = run.map((k) => `${xs[k].toFixed(1)} ${y(values[k]).toFixed(1)}`);
  // one value alone is a point
  return `M${points.join("L")}${points.length === 1 ? "h0.01" : ""}`;
}

function ring(run, { low, high }, xs, y) {
  const side = (values, order) => order.map((k) => `${xs[k].toFixed(1)} ${y(values[k]).toFixed(1)}`).join("L");
  return `M${side(high, run)}L${side(low, [...run].reverse())}Z`;
}

function scales({ low, high, start, stop, width, height, frame, x, y }) {
  const digits = high - low < 2 ? 2 : 1;
  const levels = [0, 0.5, 1].map((part) => low + part * (high - low));
  const days = stop - start > 2 * 86_400_000;
  const instants = [0, 0.25, 0.5, 0.75, 1].map((part) => start + part * (stop - start));
  const anchor = (k) => (k === 0 ? "start" : k === instants.length - 1 ? "end" : "middle");
  return [
    levels.map((level) => [
      svg("line", { class: "grid", x1: frame.left, x2: width - frame.right, y1: y(level), y2: y(level) }),
      svg("text", { x: frame.left - 6, y: y(level) + 4, "text-anchor": "end" }, number(level, digits)),
    ]),
    instants.map((instant, k) =>
      svg("text", { x: x(instant), y: height - 6, "text-anchor": anchor(k) }, utc(instant, days ? "date" : "minute")),
    ),
  ];
}
