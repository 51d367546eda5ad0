/** @file What the samples of both methods and the smoothed angles look like: panels of yaw, roll and pitch, and the table of the same figures. */

import { AXES } from "../api.js";
import { element } from "../element.js";
import { number, utc, words } from "../words.js";

/** Asked for of every span. */
export const QUANTITIES = AXES.flatMap((axis) => [`${axis}_deg`, `${axis}_sigma_deg`, `${axis}_protection_deg`]);
/** Asked for beside them: the live series of smoothed rows, which is some hours behind. */
export const SMOOTHED = { quantity: AXES.map((axis) => `${axis}_deg`), method: "robust_smoothed", version: "smoothed" };
/** Smoothed rows of consecutive five minutes are nearer to each other, s. */
const JOINED_S = 600;
/** An interval with more rows is drawn as the span of its values. */
const ROWS_OF_LINE = 10;
const SIGMAS = 2;

/**
 * Samples column by column; columns by method and quantity, null where an interval has no value.
 * @typedef {Object} Curves
 * @property {number[]} epochs s since 1970.
 * @property {Map<string, {n: number[], avg: (number | null)[], min: (number | null)[], max: (number | null)[]}>} columns
 * @property {number} interval s.
 */

/** @param {...any} given Answers of `GET …/samples` on the same intervals; false: was not asked for. @returns {Curves} */
export function curvesOf(...given) {
  const answers = given.filter(Boolean);
  const epochs = [...new Set(answers.flatMap((answer) => answer.epochs))].sort();
  const columns = answers.flatMap((answer) => {
    const places = new Map(answer.epochs.map((epoch, place) => [epoch, place]));
    const placed = (values, nothing = null) => epochs.map((epoch) => values[places.get(epoch)] ?? nothing);
    return answer.series.map(({ quantity, method, n, avg, min, max }) => [`${method} ${quantity}`, { n: placed(n, 0), avg: placed(avg), min: placed(min), max: placed(max) }]);
  });
  return { epochs: epochs.map((epoch) => Date.parse(epoch) / 1000), columns: new Map(columns), interval: answers[0].interval_s };
}

/**
 * Return samples of which the newest are replaced by a later answer on the same intervals: none is lost, none is twice.
 * @param {Curves} held @param {Curves} later @param {number} since s since 1970: begin of the later answer.
 */
export function renewed(held, later, since) {
  const kept = held.epochs.filter((epoch) => epoch < since).length;
  const nothing = (size) => ({ n: Array(size).fill(0), avg: Array(size).fill(null), min: Array(size).fill(null), max: Array(size).fill(null) });
  const columns = new Map();
  for (const key of new Set([...held.columns.keys(), ...later.columns.keys()])) {
    const [one, other] = [held.columns.get(key) ?? nothing(held.epochs.length), later.columns.get(key) ?? nothing(later.epochs.length)];
    columns.set(key, Object.fromEntries(Object.keys(one).map((part) => [part, [...one[part].slice(0, kept), ...other[part]]])));
  }
  return { epochs: [...held.epochs.slice(0, kept), ...later.epochs], columns, interval: held.interval };
}

/**
 * Return epochs with a row of nothing in each gap, so that no line crosses it, and the place of each in the samples.
 * @param {Curves} curves @param {{start: string, stop: string}[]} gaps
 */
function broken({ epochs, interval }, gaps) {
  const ends = gaps.map((gap) => [Date.parse(gap.start) / 1000, Date.parse(gap.stop) / 1000]);
  const breaks = ends.filter(([start, stop]) => stop - start >= interval).map(([start, stop]) => (start + stop) / 2);
  const [rows, places] = [[], []];
  let next = 0;
  epochs.forEach((epoch, place) => {
    while (next < breaks.length && breaks[next] < epoch) {
      if (place > 0 && breaks[next] > epochs[place - 1]) {
        rows.push(breaks[next]);
        places.push(-1);
      }
      next += 1;
    }
    rows.push(epoch);
    places.push(place);
  });
  return { rows, places };
}

/** Return smoothed angles, undefined where a line goes on from one row to the next. */
function joined(values, epochs) {
  let last = -Infinity;
  return values.map((value, place) => {
    if (value !== null) last = epochs[place];
    return value ?? (epochs[place] - last < JOINED_S ? undefined : null);
  });
}

/**
 * Return epochs and panels of the axes: lines with sigma and protection level where rows stand close, else their span.
 * @param {Curves} curves @param {{gaps: any[], methods: string[], limits: {value: number, tone: string}[]}} given The driving method first, the smoothed angles last where they are shown.
 * @returns {{epochs: number[], places: number[], panels: import("../chart.js").Panel[]}}
 */
export function panelsOf(curves, { gaps, methods, limits }) {
  const { columns } = curves;
  const { rows, places } = broken(curves, gaps);
  const isWide = isEnvelope(curves);
  const column = (method, quantity, part) => {
    const values = columns.get(`${method} ${quantity}`)?.[part];
    return places.map((place) => (place < 0 || !values ? null : values[place]));
  };
  const around = (centre, size, factor) => centre.map((value, place) => (value === null || size[place] === null ? null : value + factor * size[place]));
  const [driving, other, smoothed] = methods;
  const panels = AXES.map((axis) => {
    const angle = (method, part) => column(method, `${axis}_deg`, part);
    const spread = (method, tone) => ({ low: angle(method, "min"), high: angle(method, "max"), tone, share: 0.35 });
    const centre = angle(driving, "avg");
    const protection = column(driving, `${axis}_protection_deg`, "max");
    const [low, high] = isWide ? [angle(driving, "min"), angle(driving, "max")] : [centre, centre];
    const sigma = column(driving, `${axis}_sigma_deg`, "max");
    const levels = [{ low: around(low, protection, -1), high: around(high, protection, 1), tone: "quiet", share: 0.14 }];
    const near = isWide
      ? [spread(other, "interactive"), spread(driving, "text")]
      : [{ low: around(centre, sigma, -SIGMAS), high: around(centre, sigma, SIGMAS), tone: "quiet", share: 0.3 }];
    const lines = isWide
      ? []
      : [{ name: other, values: angle(other, "avg"), tone: "interactive", isDashed: true }, { name: driving, values: centre, tone: "text" }];
    if (smoothed) lines.push({ name: smoothed, values: joined(angle(smoothed, "avg"), rows), tone: "smoothed" });
    return { title: words(`app.axis.${axis}`), lines, bands: [...levels, ...near], limits };
  });
  return { epochs: rows, places, panels };
}

/** Return whether intervals hold so many rows that only the span of their values is drawn. */
export function isEnvelope({ columns }) {
  const counts = [...columns.values()].map(({ n }) => n).find((n) => n.some((count) => count > 0)) ?? [];
  const held = counts.filter((count) => count > 0).sort((one, other) => one - other);
  return (held[held.length >> 1] ?? 0) > ROWS_OF_LINE;
}

/**
 * Return what the curves are, each with a piece of it.
 * @param {string[]} methods As they are drawn. @param {boolean} isWide
 */
export function legendOf(methods, isWide) {
  const [driving, other, smoothed] = methods.map((method) => words(`views.history.method.${method}`));
  const kinds = isWide
    ? { "band driving": driving, "band other": other, "band protection": words("views.history.legend.protection") }
    : { "line driving": driving, "line other": other, "band sigma": words("views.history.legend.sigma"), "band protection": words("views.history.legend.protection") };
  if (smoothed) kinds["line smoothed"] = isWide ? words("views.history.legend.mean", { method: smoothed }) : smoothed;
  return Object.entries({ ...kinds, "line limits": words("views.history.legend.limits") }).map(([kind, text]) => element("span", {}, element("span", { class: `key ${kind}`, "aria-hidden": "true" }), text));
}

/**
 * Return what the methods say in one interval, as text.
 * @param {Curves} curves @param {number} place Of the interval; a number behind the last stands for none. @param {string[]} methods
 */
export function readingOf({ epochs, columns }, place, methods) {
  const said = AXES.map((axis) => {
    const angles = methods.map((method) => rangeText(columns.get(`${method} ${axis}_deg`), place));
    return `${words(`app.axis.${axis}`)} ${angles.join(" / ")}`;
  });
  return [utc((epochs[place] ?? NaN) * 1000), ...said].join("   ");
}

function rangeText(column, place) {
  if (!column || column.avg[place] === null || column.avg[place] === undefined) return number(null);
  return column.n[place] > 1
    ? words("views.history.range", { low: number(column.min[place], 3), high: number(column.max[place], 3) })
    : number(column.avg[place], 3);
}

/**
 * Return the samples as a table, evenly chosen where there are more than `most`.
 * @param {Curves} curves @param {string[]} methods @param {number} most
 */
export function curveTable(curves, methods, most) {
  const step = Math.max(1, Math.ceil(curves.epochs.length / most));
  const places = curves.epochs.map((_, place) => place).filter((place) => place % step === 0);
  const kinds = methods.flatMap((method) => AXES.map((axis) => [method, axis]));
  const head = kinds.map(([method, axis]) => element("th", { scope: "col" }, words("views.history.column.angle", { axis: words(`app.axis.${axis}`), method: words(`views.history.method.${method}`) })));
  const rows = places.map((place) =>
    element("tr", {}, element("th", { scope: "row" }, utc(curves.epochs[place] * 1000)), kinds.map(([method, axis]) => element("td", {}, rangeText(curves.columns.get(`${method} ${axis}_deg`), place)))),
  );
  return element("table", {}, element("caption", {}, words("views.history.figures")),
    element("thead", {}, element("tr", {}, element("th", { scope: "col" }, words("views.history.column.start")), head)),
    element("tbody", {}, rows),
  );
}
