/** @file Calibrations: the list, one of them carrier by carrier beside the active one, and what activating it will do. */

import { Problem, post } from "../../api.js";
import { element, fill } from "../../element.js";
import { ask } from "../../lists/dialog.js";
import { field, foreign, row, table } from "../../lists/table.js";
import { failure } from "../../parts/problem.js";
import { symbol } from "../../parts/symbol.js";
import { number, utc, words } from "../../words.js";

export const AXES = ["yaw", "roll", "pitch"];
export const REASON_LENGTH = 1000;
/** Kinds of sensors that send attitude references. */
export const SENSORS = ["star_tracker", "earth_sensor", "radio_beacon", "other"];

/** @param {string} key Below the words of this view. @param {Object<string, any>} values */
export const w = (key, values = {}) => words(`views.calibration.${key}`, values);

export const axisWords = (axis) => words(`app.axis.${axis}`);

/** Return who made something and when. @param {any} made */
export const madeBy = (made) => [utc(made.created_at), " ", foreign(made.created_by)];

/** @param {string} key Of the words of a value. */
export function chooser(label, values, key, onchange = null) {
  return element("select", { "aria-label": label, onchange }, values.map((value) => element("option", { value }, w(`${key}.${value}`))));
}

/** Return angles in words. @param {any} angles By axis; null where they are not known. @param {string} suffix Of the axes. */
export const angleText = (angles, suffix = "") => AXES.map((axis) => `${axisWords(axis)} ${number(angles?.[axis + suffix], 3)}`).join(", ");

/** @param {{start: string, stop: string} | null} window_ */
export const windowText = (window_) => (window_ ? `${utc(window_.start)} – ${utc(window_.stop)}` : number(null));

/** Return a list of sentences of the service, which are English. @param {string[] | undefined} texts */
export function sentences(texts) {
  return texts?.length > 0 && element("ul", { lang: "en" }, texts.map((text) => element("li", {}, element("bdi", {}, text))));
}

/** Show why something was not done, with a button that tries again where that helps. @param {Element} said */
export function sayProblem(said, error, again = null) {
  const problem = error instanceof Problem ? error : new Problem({ detail: String(error) });
  const causes = problem.errors?.length > 0 && sentences(problem.errors.map((each) => `${each.pointer ?? ""} ${each.detail ?? ""}`));
  fill(said, failure(problem), causes, again && element("button", { type: "button", onclick: again }, words("app.list.again")));
}

/** Of the list; the active ones are there always. */
const SHOWN = 20;
const CRITERIA = ["stable", "linear", "dominant"];
const COLUMNS = ["id", "state", "method", "quiet", "turns", "created", "actions"];

/** Return whether the job of a calibration has not ended. @param {any} calibration */
export const isUnfinished = ({ state, observability }) => state === "draft" && !observability;

/** Return the active calibration of a method, undefined where there is none. @param {any[]} all @param {string} method */
export const activeOf = (all, method) => all.find((each) => each.state === "active" && each.method === method);

/** @param {any[]} all Newest first. @param {any} given `driving` returns the state of control and its method. */
export function calibrationTable(all, given) {
  const rows = all.filter((each, place) => place < SHOWN || each.state === "active").map((each) => {
    const pick = element("button", { type: "button", "aria-pressed": each.id === given.chosen, onclick: () => given.choose(each.id) }, w("number", { id: each.id }));
    const mayActivate = given.mayOperate && each.observability && ["draft", "superseded"].includes(each.state);
    const actions = mayActivate && element("button", { type: "button", onclick: () => activate(each, all, given) }, w("activate.button"));
    return row(pick, stateWords(each), w(`method.${each.method}`), windowText(each.quiet), windowText(each.turns), madeBy(each), actions);
  });
  return table(w("list"), COLUMNS.map((each) => w(`column.${each}`)), rows);
}

function stateWords(calibration) {
  const state = isUnfinished(calibration) ? "running" : calibration.state;
  return [state === "failed" && [symbol("serious"), " "], w(`state.${state}`)];
}

function activate(one, all, given) {
  const isRefused = one.quality.turns === "contradicted";
  const reason = element("input", { maxLength: REASON_LENGTH, autocomplete: "off", required: true });
  const effects = element("ul", {}, consequences(one, all, given.driving()).map((text) => element("li", {}, text)));
  ask({
    title: w("activate.title", { id: one.id }),
    body: [effects, isRefused && [sentences(one.quality.warnings?.slice(0, 1)), field(w("activate.reason"), reason)]],
    confirm: w("activate.button"),
    act: async () => {
      await post(`${given.path}/calibrations/${one.id}:activate`, isRefused ? { override_reason: reason.value.trim() } : undefined);
      await given.changed();
    },
  });
}

/** Return what activating will do, a sentence each. */
function consequences(one, all, { method, isArmed, isAligned }) {
  const former = activeOf(all, one.method);
  const other = activeOf(all, one.method === "paper" ? "geometry" : "paper");
  const serves = one.method === "paper" ? ["paper"] : ["robust", ...(other ? [] : ["paper"])];
  const used = (calibration) => new Set((calibration?.carriers ?? []).filter(({ selected }) => selected).map(({ id }) => id));
  const [now, before] = [used(one), used(former)];
  const only = (some, others) => [...some].filter((id) => !others.has(id)).join(", ");
  const warnings = one.quality.warnings?.length ?? 0;
  return [
    former ? w("activate.replaces", { former: former.id }) : w("activate.first"),
    w("activate.serves", { methods: serves.map((each) => words(`views.history.method.${each}`)).join(", ") }),
    one.method === "paper" && !other && w("activate.paperOnly"),
    former && only(now, before) && w("activate.gained", { carriers: only(now, before) }),
    former && only(before, now) && w("activate.lost", { carriers: only(before, now) }),
    one.quality.yaw_sign === "unproven" && w("activate.yaw"),
    warnings > 0 && w("activate.warnings", { count: warnings }),
    w("activate.rows"),
    isArmed && serves.includes(method) && w("activate.trips"),
    w(isAligned && (former || (one.method === "paper" && other)) ? "activate.realign" : "activate.align"),
  ].filter(Boolean);
}

/** Return the report of a calibration beside the active one of its method. @param {any} one @param {any} active */
export function report(one, active) {
  const former = active && active.id !== one.id ? active : null;
  const compared = (value, was) => [value, former && element("span", { class: "was" }, w("was", { value: was }))];
  const sensors = AXES.map((axis) => `${axisWords(axis)} ${w(`sensor.${one.sources[axis]}`)}`).join(", ");
  const count = (calibration) => (calibration?.carriers ?? []).filter(({ selected }) => selected).length;
  const facts = [
    ["windows", [windowText(one.quiet), "; ", windowText(one.turns)]],
    ["sensors", sensors],
    one.observability && ["crlb", compared(angleText(one.observability.crlb_deg), angleText(former?.observability?.crlb_deg))],
    one.observability && ["used", compared(w("ofAll", { count: count(one), all: one.carriers.length }), w("ofAll", { count: count(former), all: former?.carriers.length ?? 0 }))],
    one.quality.turns && ["turns", w(`turns.${one.quality.turns}`)],
    one.override_reason && ["overridden", foreign(one.override_reason)],
    ...["yaw_sign", "common_sign"].map((sign) => one.quality[sign] && [sign, w(`sign.${one.quality[sign]}`)]),
    one.error && ["error", element("bdi", { lang: "en" }, one.error)],
  ].filter(Boolean);
  return element("section", { class: "report", "aria-label": w("report") },
    element("h2", {}, w("reportOf", { id: one.id }), " – ", stateWords(one), former && `; ${w("beside", { id: former.id })}`),
    element("dl", { class: "facts" }, facts.map(([key, value]) => [element("dt", {}, w(`fact.${key}`)), element("dd", {}, value)])),
    one.quality.warnings?.length > 0 && element("div", { class: "warnings" }, element("h3", {}, symbol("caution"), " ", w("warnings")), sentences(one.quality.warnings)),
    one.carriers.length > 0 && carrierTable(one, former));
}

function carrierTable(one, former) {
  const [now, before] = [one, former].map((calibration) => new Map((calibration?.carriers ?? []).map((each) => [each.id, each])));
  const ids = [...new Set([...now.keys(), ...before.keys()])];
  const heads = [words("views.carriers.column.carrier"), w("column.axis"), ...AXES.map((axis) => w("column.sensitivity", { axis: axisWords(axis) })), w("column.residual"), w("column.harmonic"), w("column.verdict")];
  return table(w("report"), heads, ids.map((id) => {
    const [new_, old] = [now.get(id), before.get(id)];
    const cell = (textOf) => [new_ ? textOf(new_) : number(null), former && element("span", { class: "was" }, w("was", { value: old ? textOf(old) : number(null) }))];
    return row(
      foreign(id),
      cell((each) => (AXES.includes(each.axis) ? axisWords(each.axis) : w("mixed"))),
      ...AXES.map((axis) => cell((each) => number(each.sensitivity_db_per_deg?.[axis], 3))),
      cell((each) => number(each.residual_db, 3)),
      cell((each) => number(each.harmonic?.rms_db, 3)),
      verdict(new_, former && old),
    );
  }));
}

/** Say whether a carrier is selected, or why not, and whether that is another verdict than before. */
function verdict(carrier, before) {
  if (!carrier) return w("notHere");
  const missed = CRITERIA.filter((each) => !carrier.criteria_met.includes(each));
  const isOther = before && before.selected !== carrier.selected;
  return [
    isOther && [symbol("caution"), " "],
    w(carrier.selected ? "selected" : "leftOut"),
    isOther && `; ${w(before.selected ? "wasSelected" : "wasLeftOut")}`,
    missed.length > 0 && `; ${missed.map((each) => w(`missed.${each}`)).join(", ")}`,
    sentences(carrier.rejected_because),
  ];
}
