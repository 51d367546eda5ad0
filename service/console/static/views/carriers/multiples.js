/** @file Small multiples: of each carrier the last hour of its level over its model, and of its residual. */

import { element, fill, setText } from "../../element.js";
import { number, words } from "../../words.js";
import { carrierAddress } from "./table.js";
import { reasonWords, stateLevel, stateWords } from "./words.js";
import { symbol } from "../../parts/symbol.js";
import { trace } from "./trace.js";

export function carrierMultiples() {
  let cells = [];
  let samples = null;
  const list = element("ul", { class: "multiples" });
  return {
    node: element("div", {}, element("p", { class: "detail" }, words("views.carriers.legend.multiples")), list),
    reset(carriers) {
      cells = carriers.map(cellOf);
      samples = null;
      fill(list, cells.map((cell) => cell.node));
    },
    draw(carriers) {
      for (const cell of cells) cell.draw(carriers.states.get(cell.id), carriers.reasons.get(cell.id));
      if (samples === carriers.samples) return;
      samples = carriers.samples;
      for (const cell of cells) cell.drawTraces(samples);
    },
  };
}

function cellOf({ id }) {
  const mark = element("span");
  const said = element("span");
  const figures = element("p", { class: "figures" });
  const traces = element("div");
  return {
    id,
    node: element("li", {}, element("h2", {}, mark, element("a", { href: carrierAddress(id) }, element("bdi", {}, id))), element("p", { class: "said" }, said), traces, figures),
    draw(state, reason) {
      const level = stateLevel(state);
      fill(mark, level !== "normal" && symbol(level));
      setText(said, [stateWords(state), reasonWords(state, reason)].filter(Boolean).join(": "));
      const isKnown = Number.isFinite(state?.c_n0_db_hz);
      setText(figures, words(isKnown ? "views.carriers.cell" : "views.carriers.cellResidual", { residual: number(state?.residual_db, 2), cN0: number(state?.c_n0_db_hz, 1) }));
    },
    drawTraces(found) {
      const of = found?.traces.get(id);
      fill(traces, of ? [levels(found, of, id), residuals(found, of, id)] : element("p", { class: "detail" }, words("views.carriers.noSamples")));
    },
  };
}

/** Return the trace of level and model of a carrier. */
export function levels(found, { power_dbm: power, expected_dbm: expected }, id, options = {}) {
  const lines = [power && { values: power.avg, kind: "level" }, expected && { values: expected.avg, kind: "model" }].filter(Boolean);
  const bands = options.isFramed && power ? [{ low: power.min, high: power.max }] : [];
  return trace({ ...found, ...options, lines, bands, label: words("views.carriers.trace.levels", { id, ...extremes(power) }) });
}

/** Return the trace of the residual of a carrier. */
export function residuals(found, { residual_db: residual }, id, options = {}) {
  const lines = residual ? [{ values: residual.avg, kind: "residual" }] : [];
  return trace({ ...found, ...options, lines, zero: 0, bands: options.bands ?? [], label: words("views.carriers.trace.residuals", { id, ...extremes(residual) }) });
}

/** Return least, greatest and last value as words have them. */
export function extremes(series, digits = 1) {
  const held = (values) => (values ?? []).filter(Number.isFinite);
  const least = held(series?.min).reduce((a, b) => Math.min(a, b), Infinity);
  const greatest = held(series?.max).reduce((a, b) => Math.max(a, b), -Infinity);
  return { least: number(least, digits), greatest: number(greatest, digits), last: number(held(series?.avg).at(-1) ?? null, digits) };
}
