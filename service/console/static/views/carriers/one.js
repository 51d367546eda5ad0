/** @file One carrier: state and reason, traces with their bands, harmonic, sensitivity, its place on the map. */

import { element, fill, setText } from "../../element.js";
import { choice } from "../../lists/table.js";
import { duration, number, utc, words } from "../../words.js";
import { carrierMap } from "./map.js";
import { sampled } from "./model.js";
import { extremes, levels, residuals } from "./multiples.js";
import { reasonNext, reasonWords, stateLevel, stateWords } from "./words.js";
import { presentOf } from "../../parts/header.js";
import { failure } from "../../parts/problem.js";
import { symbol } from "../../parts/symbol.js";
import { trace } from "./trace.js";

const HOUR_MS = 3_600_000;
const SPANS_H = [1, 6, 24, 168, 720];
const INTERVALS = 240;
const EACH_MS = 60_000;
const FRAMED = { isFramed: true, width: 720, height: 190 };
/** Half width of the band around zero, sigmas. */
const BAND_SIGMAS = 2;

/** @param {{store: any, spacecraft: any, parameters: URLSearchParams, go: any}} context @param {string} id */
export function oneCarrier({ store, spacecraft, parameters, go }, id) {
  const hours = SPANS_H.includes(Number(parameters.get("hours"))) ? Number(parameters.get("hours")) : 6;
  const ending = new AbortController();
  const mark = element("span");
  const title = element("bdi", {}, id);
  const said = element("p", { role: "status" });
  const traces = element("div", { class: "traces" }, element("p", { class: "detail" }, words("views.carriers.loading")));
  const facts = element("div", { class: "plan-facts" });
  const map = element("figure", { class: "map-side" });
  const spans = choice(words("views.carriers.span"), SPANS_H.map((each) => [String(each), duration(each * 3600)]), (each) => go("carriers", { carrier: id, hours: each }), String(hours));
  let sampledAt = -Infinity;
  let shown = "";

  async function sample(state) {
    const present = presentOf(store.get());
    if (!Number.isFinite(present) || performance.now() - sampledAt < EACH_MS) return;
    sampledAt = performance.now();
    try {
      const found = await sampled({ spacecraft, carrier: id, start: present - hours * HOUR_MS, stop: present, count: INTERVALS }, { signal: ending.signal });
      fill(traces, tracesOf(found, id, state));
    } catch (error) {
      if (!ending.signal.aborted) fill(traces, failure(error));
    }
  }

  const node = element("div", { class: "one" }, element("p", {}, element("a", { href: "#/carriers" }, words("views.carriers.back"))),
    element("h1", {}, mark, title), said, spans,
    element("div", { class: "sides" }, traces, element("div", { class: "map-side" }, map, facts)),
  );
  return {
    node,
    draw(carriers) {
      const carrier = carriers.plan?.carriers.find((each) => each.id === id);
      const [state, reason] = [carriers.states.get(id), carriers.reasons.get(id)];
      fill(mark, stateLevel(state) !== "normal" && symbol(stateLevel(state)));
      const isGone = carriers.plan && !carrier;
      setText(said, isGone ? words("views.carriers.notInPlan", { plan: carriers.plan.plan_id }) : sayingOf(state, reason));
      sample(state);
      const of = carriers.calibration?.carriers.find((each) => each.id === id);
      const key = JSON.stringify([carrier, of, stateLevel(state)]);
      if (!carrier || key === shown) return;
      shown = key;
      setText(title, [id, carrier.name].filter(Boolean).join(" · "));
      fill(facts, factsOf(carrier, of));
      const levelOf = (each) => stateLevel(carriers.states.get(each));
      fill(map, carrierMap({ longitudeDeg: spacecraft.longitude_deg, carriers: carriers.plan.carriers, calibration: carriers.calibration, levelOf, chosen: id }));
    },
    close: () => ending.abort(),
  };
}

function sayingOf(state, reason) {
  const said = [stateWords(state), reasonWords(state, reason)].filter(Boolean).join(": ");
  return [`${said}.`, reasonNext(reason)].filter(Boolean).join(" ");
}

function tracesOf(found, id, state) {
  const of = found.traces.get(id);
  if (!of || !found.epochs.length) return element("p", { class: "detail" }, words("views.carriers.noSamples"));
  const half = BAND_SIGMAS * (state?.sigma_db ?? NaN);
  const around = (center) => ({ low: center.map((value) => (value === null ? null : value - half)), high: center.map((value) => (value === null ? null : value + half)) });
  const band = Number.isFinite(half) ? [around(found.epochs.map(() => 0))] : [];
  const cN0 = of.c_n0_db_hz?.n.some((count) => count > 0);
  return [
    element("h2", {}, words("views.carriers.part.levels")),
    levels(found, of, id, FRAMED),
    element("p", { class: "detail" }, words("views.carriers.legend.levels")),
    element("h2", {}, words("views.carriers.part.residuals")),
    residuals(found, of, id, { ...FRAMED, bands: band }),
    element("p", { class: "detail" }, words(band.length ? "views.carriers.legend.residuals" : "views.carriers.legend.noSigma", { sigma: number(state?.sigma_db, 2) })),
    element("h2", {}, words("views.carriers.part.cN0")),
    cN0
      ? trace({ ...found, ...FRAMED, lines: [{ values: of.c_n0_db_hz.avg, kind: "level" }], bands: [{ low: of.c_n0_db_hz.min, high: of.c_n0_db_hz.max }], label: words("views.carriers.trace.cN0", { id, ...extremes(of.c_n0_db_hz) }) })
      : element("p", { class: "detail" }, words("views.carriers.noCN0")),
  ];
}

function factsOf(carrier, of) {
  const { station } = carrier;
  const mega = (hertz) => (hertz ? number(hertz / 1e6, 3) : "");
  const place = station && words("views.carriers.place", { latitude: number(station.latitude_deg, 2), longitude: number(station.longitude_deg, 2) });
  const fact = (key, value) => value && [element("dt", {}, words(`views.carriers.fact.${key}`)), element("dd", {}, element("bdi", {}, value))];
  const choice = (key, code) => fact(key, words(`views.carriers.choice.${code}`));
  return [
    element("h2", {}, words("views.carriers.part.plan")),
    element("dl", {}, fact("transponder", carrier.transponder), fact("station", station?.name), fact("place", place), fact("band", carrier.band), fact("uplink", mega(carrier.uplink_hz)), fact("downlink", mega(carrier.downlink_hz)), choice("powerControl", carrier.uplink_power_control), choice("transponderMode", carrier.transponder_mode), !carrier.enabled && fact("enabled", words("views.carriers.disabled"))),
    element("h2", {}, words("views.carriers.part.calibration")),
    of ? calibrationOf(of) : element("p", { class: "detail" }, words("views.carriers.notCalibrated")),
  ];
}

function calibrationOf(of) {
  const fact = (key, values) => [element("dt", {}, words(`views.carriers.fact.${key}`)), element("dd", {}, words(`views.carriers.value.${key}`, values))];
  const { harmonic, sensitivity_db_per_deg: slope } = of;
  return [
    element("dl", {}, fact("sensitivity", { yaw: number(slope?.yaw, 2), roll: number(slope?.roll, 2), pitch: number(slope?.pitch, 2) }),
      fact("level", { level: number(of.level_dbm, 2) }),
      harmonic && fact("harmonic", { amplitude: number(harmonic.amplitude_db, 2), rms: number(harmonic.rms_db, 2), hours: number(harmonic.period_s / 3600, 2), node: utc(harmonic.node_epoch) }),
      fact("noise", { sigma: number(of.sigma_white_db, 3) }),
    ),
    of.rejected_because?.length > 0 && element("ul", { class: "detail", lang: "en" }, of.rejected_because.map((each) => element("li", {}, each))),
  ];
}
