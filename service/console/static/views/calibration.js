/** @file Calibration: windows over readings of the sensors, the fit and its report, activation, alignment, carriers. */

import { get, post } from "../api.js";
import { element, fill } from "../element.js";
import { ask } from "../lists/dialog.js";
import { instantInput, instantMs, instantText } from "../lists/instant_input.js";
import { choice, field, foreign, row, table } from "../lists/table.js";
import { symbol } from "../parts/symbol.js";
import { duration, number, utc, words } from "../words.js";
import { AXES, REASON_LENGTH, activeOf, angleText, axisWords, calibrationTable, chooser, isUnfinished, madeBy, report, sayProblem, sentences, w, windowText } from "./calibration/report.js";
import { windowPlot } from "./calibration/windows.js";

export const name = "calibration";
const METHODS = ["geometry", "paper"];
/** Between questions how far a job is, and for calibrations that are being made elsewhere. */
const POLL_MS = 1000;
const AGAIN_MS = 5000;
const RULES = ["optimal", "paper"];
const SETS = ["optimal", "paper", "all"];
const TURNS = ["none", "standard", "far_yaw"];
const CARRIER_COLUMNS = ["carrier", "rank", "axis", "sensitivities", "sigma", "reasons"];
const SHOWN_ALIGNMENTS = 10;
const ALIGNMENT_COLUMNS = ["id", "epoch", "angles", "source", "created", "remarks"];
const MOST_DEG = 180;

/** @param {{store: any, spacecraft: any, session: any}} context */
export function show({ store, spacecraft, session }) {
  const path = `/spacecraft/${spacecraft.id}`;
  const may = (permission) => session.permissions.includes(permission);
  const ending = new AbortController();
  const { signal } = ending;
  const plot = windowPlot({ store, path, mayOperate: may("operate") });
  const aligned = alignment({ path, plot, mayOperate: may("operate"), mayApprove: may("approve") });
  const advice = selection(path);
  const said = element("div", { class: "said", "aria-live": "polite" });
  const lost = element("div");
  const list = element("div");
  const reported = element("div");
  const method = chooser(w("methodOf"), METHODS, "method");
  const start = element("button", { type: "submit", class: "primary" }, w("start"));
  let chosen = null;
  let timer = 0;
  /** Job whose progress is shown. */
  let followed = null;

  /** Read the calibrations and show them; while one is being made elsewhere, again. */
  async function load() {
    clearTimeout(timer);
    try {
      const { rows } = await get(`${path}/calibrations`, {}, { signal });
      chosen ??= rows[0]?.id ?? null;
      draw(rows);
      fill(lost);
      const left = !followed && rows.find((each) => isUnfinished(each) && each.job);
      if (left) follow(left.id, left.job).catch((error) => signal.aborted || sayProblem(said, error));
      if (rows.some(isUnfinished)) timer = setTimeout(load, AGAIN_MS);
    } catch (error) {
      if (!signal.aborted) sayProblem(lost, error, load);
    }
  }

  function draw(rows) {
    const choose = (id) => {
      chosen = id;
      draw(rows);
      list.querySelector("[aria-pressed=true]")?.focus();
    };
    const driving = () => {
      const { control, status } = store.get();
      return { method: status?.method, isArmed: Boolean(control?.armed), isAligned: Boolean(status?.alignment_id) };
    };
    fill(list, rows.length > 0 ? calibrationTable(rows, { chosen, choose, path, driving, mayOperate: may("operate"), changed: load }) : element("p", { class: "notice" }, w("none")));
    const one = rows.find(({ id }) => id === chosen);
    fill(reported, one && report(one, activeOf(rows, one.method)));
  }

  async function begin(event) {
    event.preventDefault();
    start.disabled = true;
    fill(said);
    try {
      const wanted = { quiet: plot.windowOf("quiet"), turns: plot.windowOf("turns"), method: method.value, sources: plot.sources() };
      const { id, job } = await post(`${path}/calibrations`, wanted);
      chosen = id;
      load();
      await follow(id, job);
    } catch (error) {
      if (!signal.aborted) sayProblem(said, error);
    } finally {
      start.disabled = false;
    }
  }

  /** Show how far a job is until it has ended; a question without an answer is asked again. */
  async function follow(id, job) {
    followed = job;
    const bar = element("progress", { max: 1, value: 0, "aria-label": w("progress", { id }) });
    const text = element("p", {});
    const missed = element("div");
    fill(said, text, bar, missed);
    while (!signal.aborted && followed === job) {
      try {
        const { state, progress, error } = await get(`/jobs/${job}`, {}, { signal });
        fill(missed);
        bar.value = progress;
        fill(text, w(`job.${state}`, { id, percent: number(100 * progress, 0) }), error && [" ", element("bdi", { lang: "en" }, error)]);
        if (state === "done" || state === "failed") {
          bar.remove();
          followed = null;
          await load();
          return;
        }
      } catch (error) {
        if (signal.aborted) return;
        if (error.status === 404) {
          followed = null;
          throw error;
        }
        sayProblem(missed, error);
      }
      await new Promise((resolve) => setTimeout(resolve, POLL_MS));
    }
  }

  const form = may("operate") && element("form", { class: "card", "aria-label": w("make"), onsubmit: begin },
    element("h2", {}, w("make")), plot.fieldsOf("quiet"), plot.fieldsOf("turns"), field(w("methodOf"), method), start, said);
  const node = element("section", { class: "calibration", "aria-label": w("title") },
    element("h1", {}, w("title")), plot.node, form || said,
    element("h2", {}, w("list")), lost, list, reported, aligned.node, advice.node);
  load();
  return {
    node,
    close() {
      ending.abort();
      clearTimeout(timer);
      [plot, aligned, advice].forEach((part) => part.close());
    },
  };
}

/** Angles by hand are offered to who may approve. */
function alignment({ path, plot, mayOperate, mayApprove }) {
  const ending = new AbortController();
  const said = element("div", { class: "said", "aria-live": "polite" });
  const list = element("div");
  let rows = [];
  let isManual = false;

  const reason = element("input", { maxLength: REASON_LENGTH, autocomplete: "off" });
  const epoch = instantInput({ required: true });
  const angle = (options) => element("input", { type: "number", step: "any", max: MOST_DEG, required: true, ...options });
  const angles = Object.fromEntries(AXES.map((axis) => [axis, angle({ min: -MOST_DEG })]));
  const sigmas = Object.fromEntries(AXES.map((axis) => [axis, angle({ min: 1e-6 })]));
  const fieldsOf = (inputs, key) => AXES.map((axis) => field(w(key, { axis: axisWords(axis) }), inputs[axis]));
  const manual = element("fieldset", { hidden: true, disabled: true }, element("legend", {}, w("align.manual")),
    field(w("align.epoch"), epoch), fieldsOf(angles, "align.angle"), fieldsOf(sigmas, "align.sigma"));
  const sensed = element("fieldset", {}, element("legend", {}, w("align.sensed")), plot.fieldsOf("alignment"));
  const kind = mayApprove && choice(w("align.title"), [["sensed", w("align.sensed")], ["manual", w("align.manual")]], (value) => {
    isManual = value === "manual";
    [manual.hidden, manual.disabled, sensed.hidden, sensed.disabled] = [!isManual, !isManual, isManual, isManual];
  });

  function body() {
    const override = reason.value.trim() ? { override_reason: reason.value.trim() } : {};
    if (!isManual) return { ...plot.windowOf("alignment"), sources: plot.sources(), ...override };
    const numbers = (inputs, suffix) => Object.fromEntries(AXES.map((axis) => [`${axis}${suffix}`, Number(inputs[axis].value)]));
    return { source: "manual", epoch: instantText(epoch), ...numbers(angles, "_deg"), sigma_deg: numbers(sigmas, ""), ...override };
  }

  /** Say what it will do, and do it when that is confirmed. */
  function submit(event) {
    event.preventDefault();
    const wanted = body();
    const [newest] = rows;
    const stop = isManual ? wanted.epoch : wanted.stop;
    const effects = [
      w(isManual ? "align.fromHand" : "align.fromWindow", { at: utc(stop) }),
      w("align.holds"),
      w("align.rows"),
      newest && Date.parse(newest.epoch) > Date.parse(stop) && w("align.older", { id: newest.id, epoch: utc(newest.epoch) }),
    ].filter(Boolean);
    fill(said);
    ask({
      title: w("align.title"),
      body: element("ul", {}, effects.map((text) => element("li", {}, text))),
      confirm: w("align.button"),
      act: async () => {
        const made = await post(`${path}/alignments`, wanted);
        fill(said, alignmentText(made));
        reason.value = "";
        await load();
      },
    });
  }

  async function load() {
    try {
      ({ rows } = await get(`${path}/alignments`, {}, { signal: ending.signal }));
      fill(list, rows.length > 0 ? table(w("align.list"), ALIGNMENT_COLUMNS.map((each) => w(`column.${each}`)), rows.slice(0, SHOWN_ALIGNMENTS).map(rowOf)) : element("p", { class: "notice" }, w("align.none")));
    } catch (error) {
      if (!ending.signal.aborted) sayProblem(list, error, load);
    }
  }

  function rowOf(each) {
    const sensors = each.source.split(",").map((source) => (source === "manual" ? w("align.manual") : w(`sensor.${source}`))).join(", ");
    const remarks = [each.override_reason && [w("align.overridden"), " ", foreign(each.override_reason)], sentences(each.warnings)];
    return row(w("number", { id: each.id }), utc(each.epoch), angleText(each, "_deg"), [sensors, element("span", { class: "was" }, windowText(each.window))], madeBy(each), remarks);
  }

  const form = mayOperate && element("form", { class: "card", "aria-label": w("align.title"), onsubmit: submit },
    kind, sensed, mayApprove && manual, field(w("align.reason"), reason), element("button", { type: "submit", class: "primary" }, w("align.look")), said);
  load();
  return { node: element("section", { "aria-label": w("align.title") }, element("h2", {}, w("align.title")), form, list), close: () => ending.abort() };
}

/** Say what an alignment is, and what it did to stored rows. */
function alignmentText(made) {
  return [
    element("p", {}, symbol("normal"), " ", w("align.done", { id: made.id, epoch: utc(made.epoch), angles: angleText(made, "_deg") })),
    element("p", {}, w("align.recomputed", { count: made.rows_recomputed }), " ", w("align.kept", { count: made.rows_kept }), " ", made.rows_kept > 0 && w("align.replay")),
    made.changed_carriers?.length > 0 && element("p", {}, symbol("caution"), " ", w("align.changed", { count: made.changed_carriers.length }), " ", foreign(made.changed_carriers.join(", "))),
    made.warnings?.length > 0 && element("p", {}, symbol("caution"), " ", w("warnings")),
    sentences(made.warnings),
  ];
}

/** @param {string} path Of the spacecraft. */
function selection(path) {
  const ending = new AbortController();
  const said = element("div", { "aria-live": "polite" });
  const found = element("div");
  const rule = chooser(w("selection.rule"), RULES, "rule");
  const turns = chooser(w("selection.turns"), TURNS, "turnKind");
  const count = element("input", { type: "number", min: 5, max: 1000, step: 1 });
  const start = instantInput();
  const button = element("button", { type: "submit" }, w("selection.button"));

  async function load(event) {
    event.preventDefault();
    button.disabled = true;
    fill(said);
    try {
      const answer = await get(`${path}/carrier-selection`, { rule: rule.value, turns: turns.value, count: count.value || null }, { signal: ending.signal });
      fill(found, drawn(answer, start.value ? instantMs(start) : null));
    } catch (error) {
      if (ending.signal.aborted) return;
      fill(found);
      sayProblem(said, error);
    } finally {
      button.disabled = false;
    }
  }

  const form = element("form", { class: "tools", "aria-label": w("selection.title"), onsubmit: load },
    field(w("selection.rule"), rule), field(w("selection.count"), count), field(w("selection.turns"), turns), field(w("selection.start"), start), button);
  return { node: element("section", { "aria-label": w("selection.title") }, element("h2", {}, w("selection.title")), element("p", { class: "detail" }, w("selection.advice")), form, said, found), close: () => ending.abort() };
}

function drawn(answer, startMs) {
  const basis = w("selection.basis", { id: answer.calibration_id, method: w(`method.${answer.calibration_method}`) });
  return [
    element("p", {}, basis, " ", w("selection.chosen", { count: answer.selected.length, wanted: answer.count }), " ", foreign(answer.selected.join(", "))),
    sufficiency(answer),
    sentences(answer.notes),
    setTable(answer.sets),
    table(w("selection.carriers"), CARRIER_COLUMNS.map((each) => w(`column.${each}`)), answer.carriers.map(carrierRow)),
    answer.turns && timetable(answer.turns, startMs),
  ];
}

const sufficiency = (set) => [symbol(set.sufficient ? "normal" : "caution"), " ", w(set.sufficient ? "selection.sufficient" : "selection.insufficient"), sentences(set.shortcomings)];

function setTable(sets) {
  const figures = {
    carriers: (set) => set.selected.length,
    crlb: (set) => angleText(set.crlb_deg),
    averaged: (set) => set.averaged.map(({ span_s: span, sigma_deg: sigma }) => element("span", { class: "was" }, `${duration(span)}: ${angleText(sigma)}`)),
    sufficient: sufficiency,
  };
  const rows = Object.entries(figures).map(([key, textOf]) => row(w(`figure.${key}`), ...SETS.map((name) => textOf(sets[name]))));
  return table(w("selection.sets"), [w("column.figure"), ...SETS.map((name) => w(`set.${name}`))], rows);
}

function carrierRow(carrier) {
  const rank = carrier.selected ? String(carrier.rank + 1) : w("leftOut");
  const axis = AXES.includes(carrier.axis) ? axisWords(carrier.axis) : number(null);
  return row(foreign(carrier.carrier), rank, axis, angleText(carrier.sensitivity_db_per_deg), number(carrier.sigma_db, 3), sentences(carrier.reasons));
}

function timetable({ total_s: total, steps }, startMs) {
  const rows = steps.map((step) => {
    const ends = [step.offset_s, step.offset_s + step.duration_s];
    const [from, until] = ends.map((offset) => (startMs === null ? duration(offset) : utc(startMs + 1000 * offset)));
    return row(from, until, ...AXES.map((axis) => number(step[`${axis}_deg`], 3)));
  });
  const heads = [w("column.from"), w("column.until"), ...AXES.map((axis) => words("views.history.panel", { axis: axisWords(axis) }))];
  return [element("h3", {}, w("selection.timetable", { length: duration(total) })), element("p", { class: "detail" }, w("selection.declare")), table(w("selection.turns"), heads, rows)];
}
