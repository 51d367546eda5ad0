/** @file Now: may torques go, where the satellite points, whether to trust it, and what to do first. */

import { AXES, get } from "../api.js";
import { element, fill, onFrame } from "../element.js";
import { gauge } from "../parts/gauge.js";
import { presentOf } from "../parts/header.js";
import { failure } from "../parts/problem.js";
import { linkLevel, symbol } from "../parts/symbol.js";
import { sentence } from "../parts/verdict.js";
import { duration, linkStateWords, meaning, number, utc, words } from "../words.js";

export const name = "now";
const HOUR_MS = 3_600_000;
const SAMPLES = 120;
/** What no event tells is asked for so often. */
const SLOW_MS = 30_000;
const OPERATIONS_AHEAD_MS = 7 * 24 * HOUR_MS;
/** Reasons that say the newest row is no present. */
const OLD = ["estimate_old", "expired", "no_attitude"];
const EXCLUDED_LEVEL = { absent: "serious", manual: "off", uplink_fade: "standby" };

/** @param {{store: any, spacecraft: any}} context */
export function show({ store, spacecraft }) {
  const base = `/spacecraft/${spacecraft.id}`;
  const verdict = element("h1", { class: "verdict" });
  const refused = element("div");
  const gauges = Object.fromEntries(AXES.map((axis) => [axis, gauge(axis)]));
  const cards = Object.fromEntries(["torque", "wheels", "level", "links", "operation"].map((each) => [each, card(each)]));
  const carriers = element("ul", { class: "strip", "aria-label": words("views.now.carriers") });
  const state = { plan: null, operations: [], telemetry: null, isClosed: false };

  const draw = onFrame(() => {
    if (state.isClosed) return;
    const { status, attitude, control, torque, link, problem } = store.get();
    const conditions = control?.conditions ?? [];
    const method = status?.method ?? "robust";
    const [row, other] = [attitude[method], attitude[method === "robust" ? "paper" : "robust"]];
    // a row that was refused is not one that never came
    drawVerdict(verdict, problem && !row ? { ...store.get(), status: null } : store.get(), row);
    const motions = status?.control.situation?.axes;
    const isStale = !row || link.state === "cut" || row.status === "EXPIRED" || OLD.some((code) => status?.control.reasons.some((each) => each.code === code));
    const age = row ? ageOf(store.get(), row) : NaN;
    for (const axis of AXES) gauges[axis].draw(axisState(axis, { row, other, control, motions, isStale, age }));
    drawTorque(cards.torque, torque);
    drawWheels(cards.wheels, spacecraft, torque, state.telemetry, conditions);
    drawLevel(cards.level, row);
    drawLinks(cards.links, status);
    drawOperation(cards.operation, state.operations, presentOf(store.get()));
    drawCarriers(carriers, state.plan, row);
  });

  async function loadHour() {
    const { status } = store.get();
    const present = status?.newest_attitude ? new Date(status.newest_attitude).getTime() : Date.now();
    const [start, stop] = [new Date(present - HOUR_MS).toISOString(), new Date(present + 1).toISOString()];
    const found = await quiet(get(`${base}/samples`, { quantity: AXES.map((axis) => `${axis}_deg`), method: status?.method ?? "robust", start, stop, count: SAMPLES, extreme_epochs: false }));
    for (const axis of found ? AXES : []) {
      gauges[axis].renew();
      const series = found.series.find((each) => each.quantity === `${axis}_deg`);
      found.epochs.forEach((epoch, index) => gauges[axis].push(new Date(epoch).getTime(), series?.avg[index] ?? NaN));
    }
    draw();
  }

  async function loadPlan() {
    state.plan = await quiet(get(`${base}/carriers`));
    draw();
  }

  async function loadSlow() {
    const present = presentOf(store.get());
    if (!Number.isFinite(present)) return;
    const former = store.get().control;
    const [now, ahead, before] = [present, present + OPERATIONS_AHEAD_MS, present - HOUR_MS].map((ms) => new Date(ms).toISOString());
    const [operations, telemetry, control] = await Promise.all([
      quiet(get(`${base}/operations`, { start: now, stop: ahead })),
      quiet(get(`${base}/telemetry`, { start: before, stop: new Date(present + 1).toISOString() })),
      quiet(get(`${base}/control`)),
    ]);
    if (state.isClosed) return;
    // an event may have brought a newer one
    if (control && store.get().control === former) store.set({ control });
    state.operations = operations?.rows ?? state.operations;
    state.telemetry = telemetry?.rows.at(-1) ?? state.telemetry;
    draw();
  }

  function pushRow(row) {
    if (row.method !== (store.get().status?.method ?? "robust")) return;
    for (const axis of AXES) gauges[axis].push(new Date(row.epoch).getTime(), row[`${axis}_deg`]);
  }

  const onPlan = (row) => row?.plan_id && state.plan && row.plan_id !== state.plan.plan_id && loadPlan();
  const first = store.subscribe((each) => each.status !== null, () => (loadHour(), loadSlow()));
  const ends = [
    first,
    store.subscribe((each) => each.problem, (problem) => (fill(refused, problem && failure(problem)), draw())),
    ...["status", "attitude", "control", "torque", "link"].map((part) => store.subscribe((each) => each[part], draw)),
    store.subscribe((each) => each.measurement, onPlan),
    store.on("attitude", pushRow),
    store.on("dropped", () => ((state.telemetry = null), loadPlan(), loadHour(), loadSlow())),
  ];
  const slow = setInterval(loadSlow, SLOW_MS);
  const aging = setInterval(draw, 1000);
  loadPlan();
  if (store.get().status) {
    loadHour();
    loadSlow();
  }
  draw();
  return {
    node: element("div", { class: "now" }, element("div", { role: "status", class: "answer" }, verdict, refused),
      element("div", { class: "gauges" }, AXES.map((axis) => gauges[axis].node)),
      element("div", { class: "cards" }, Object.values(cards).map((each) => each.node)), carriers,
    ),
    close() {
      state.isClosed = true;
      clearInterval(slow);
      clearInterval(aging);
      ends.forEach((end) => end());
    },
  };
}

/** Return the content, or null where it cannot be had now: the header says that the service does not answer. */
const quiet = (asked) => asked.catch(() => null);

function card(title) {
  const body = element("div", { class: "body" });
  const heading = words(`views.now.${title}`);
  return { node: element("section", { class: `card ${title}`, "aria-label": heading }, element("h2", {}, heading), body), body };
}

function drawVerdict(node, { status, control, link, offsetMs }, row) {
  const isCut = link.state === "cut";
  const text = isCut ? words("views.now.cut", { at: utc(link.since + offsetMs, "minute"), next: meaning("faults", "network", "next") }) : status ? sentence(status, row, control) : words("views.now.waiting");
  const level = !status ? "off" : isCut ? "serious" : (status.control.situation?.severity ?? "off");
  const key = `${level} ${text}`;
  if (node.dataset.shown === key) return;
  node.dataset.shown = key;
  fill(node, symbol(level), element("a", { href: "#/control" }, text));
}

/** Return the age of what a row stands on; while the stream is cut it grows by the clock of the workstation. */
function ageOf(state, row) {
  const since = row.status === "EXPIRED" && state.status?.control.reasons.find((each) => each.code === "expired")?.since;
  const oldest = Math.min(...[row.epoch, since || row.epoch].map((each) => new Date(each).getTime()));
  const sinceStatus = state.link.state === "cut" && state.status?.clock === "data" ? performance.now() - state.statusAt : 0;
  return Math.max(0, (presentOf(state) + sinceStatus - oldest) / 1000);
}

function axisState(axis, { row, other, control, motions, isStale, age }) {
  return {
    angle: row?.[`${axis}_deg`] ?? null,
    sigma: row?.sigma_deg?.[axis] ?? null,
    protection: row?.protection_deg?.[axis] ?? null,
    other: other?.[`${axis}_deg`] ?? null,
    motion: motions?.find((each) => each.axis === axis) ?? null,
    limit: control?.angle_limit_deg ?? null,
    alert: axis === "yaw" ? null : (control?.conditions.find((each) => each.code === "protection_level")?.limit ?? null),
    isStale,
    age,
  };
}

function pairs(entries) {
  return element("dl", {}, entries.map(([term, value]) => element("div", {}, element("dt", {}, term), element("dd", {}, value))));
}

/** Fill a card where it says something else than before. */
function put({ body }, key, make) {
  const text = JSON.stringify(key ?? null);
  if (body.dataset.shown === text) return;
  body.dataset.shown = text;
  fill(body, make());
}

function drawTorque(each, torque) {
  put(each, torque && [torque.epoch, torque.inhibitions], () => {
    if (!torque) return words("views.now.none");
    const angle = (axis) => words("views.now.change", { impulse: number(1000 * (torque.impulse_n_m_s?.[axis] ?? NaN), 3), angle: number(torque.predicted?.angle_change_deg?.[axis], 3) });
    return pairs(AXES.map((axis) => [words(`app.axis.${axis}`), angle(axis)]));
  });
}

function drawWheels(each, spacecraft, torque, telemetry, conditions) {
  const held = telemetry?.wheel_momentum_n_m_s ?? null;
  const change = torque?.predicted?.wheel_momentum_n_m_s ?? [];
  const share = conditions.find((one) => one.code === "momentum");
  put(each, [held, change, share?.value], () => {
    const limit = spacecraft.wheels?.momentum_limit_n_m_s;
    const entries = change.map((value, index) => [
      words("views.now.wheel", { number: index + 1 }),
      held ? words("views.now.heldAndChange", { held: number(held[index], 2), change: number(value, 4) }) : words("views.now.wheelChange", { change: number(value, 4) }),
    ]);
    if (share && Number.isFinite(share.value)) entries.push([words("views.now.fullest"), words("views.now.share", { share: number(share.value, 0), limit: number(share.limit, 0) })]);
    else entries.push([words("views.now.wheelLimit"), `${number(limit, 1)} ${words("app.unit.n_m_s")}`]);
    return pairs(entries);
  });
}

function drawLevel(each, row) {
  const fade = row?.downlink_fade ? row.downlink_fade_db : 0;
  put(each, [row?.epoch, row?.common_db, row?.downlink_fade, fade, row?.residual_rms_db], () => {
    const db = (value) => `${number(value, 2)} ${words("app.unit.db")}`;
    const isFading = row?.downlink_fade;
    return pairs([
      [words("views.now.common"), db(row?.common_db)],
      [words("views.now.fade"), isFading ? [symbol("caution"), " ", db(fade)] : Number.isFinite(row?.common_db) ? words("views.now.none") : number(null)],
      [words("views.now.residual"), db(row?.residual_rms_db)],
      [words("views.now.rowOf"), element("time", { class: "row" }, utc(row?.epoch, "time"))],
    ]);
  });
}

function drawLinks(each, status) {
  const links = status?.links ?? [];
  put(each, links.map((link) => [link.id, link.source, link.state, link.warnings.length, link.rows_missing]), () => {
    if (!links.length) return words("views.now.none");
    return element("ul", {}, links.map((link) => element("li", {}, symbol(linkLevel(link)), ` ${link.id ?? link.source} `, linkText(link))));
  });
}

function linkText(link) {
  const warnings = link.warnings.map(({ code }) => meaning("problems", code));
  const missing = link.rows_missing ? words("views.now.missing", { count: link.rows_missing }) : "";
  return [link.state ? linkStateWords(link.state) : words("views.now.source"), ...warnings, missing].filter(Boolean).join("; ");
}

function drawOperation(each, operations, present) {
  const next = [...operations].sort((one, other) => one.start.localeCompare(other.start))[0];
  const isNow = next && new Date(next.start).getTime() <= present;
  const minutes = next && Math.round((new Date(isNow ? next.stop : next.start).getTime() - present) / 60_000);
  put(each, next && [next.id, next.revision, isNow, minutes], () => {
    if (!next) return words("views.now.none");
    const when = words(isNow ? "views.now.until" : "views.now.begins", { time: duration(60 * minutes), at: utc(isNow ? next.stop : next.start, "minute") });
    return [element("p", {}, element("strong", {}, meaning("operations", next.kind))), element("p", {}, when), element("p", { class: "comment" }, next.comment)];
  });
}

function drawCarriers(node, plan, row) {
  const reasons = new Map((row?.excluded ?? []).map(({ carrier, reason }) => [carrier, reason]));
  const key = JSON.stringify([plan?.plan_id, plan?.sha256, [...reasons], row?.carriers_used, Boolean(row)]);
  if (node.dataset.shown === key) return;
  node.dataset.shown = key;
  const all = plan?.carriers ?? [];
  const count = element("li", { class: "count" }, words("views.now.used", { used: row?.carriers_used ?? 0, all: all.length }));
  node.classList.toggle("many", all.length > 40);
  fill(node, count, all.map((carrier) => carrierOf(carrier, reasons.get(carrier.id), row?.carriers_used > 0)));
}

/** Without an excluding reason a carrier is used, but in a row that gave no attitude none is. */
function carrierOf(carrier, reason, isFix) {
  const level = reason ? (EXCLUDED_LEVEL[reason] ?? "caution") : carrier.enabled && isFix ? "normal" : "off";
  const said = reason ? meaning("exclusions", reason) : words(!carrier.enabled ? "views.now.carrierOff" : isFix ? "views.now.carrierUsed" : "views.now.carrierUnused");
  return element("li", { class: reason ? "excluded" : "", title: `${carrier.id}: ${said}` }, symbol(level), element("span", { class: "id" }, carrier.id), element("span", { class: "why" }, reason ? said : ""));
}
