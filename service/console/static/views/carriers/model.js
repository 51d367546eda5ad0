/** @file What the views of carriers show: plan, calibration, newest state of each carrier, its last hour. */

import { get } from "../../api.js";
import { presentOf } from "../../parts/header.js";

const HOUR_MS = 3_600_000;
const SAMPLES_EACH_MS = 60_000;
const STATES_EACH_MS = 1000;

/**
 * @typedef {Object} Carriers
 * @property {any} plan Answer of `GET …/carriers`; null: none yet.
 * @property {any} calibration The one in force; null: none.
 * @property {Map<string, any>} states Newest state by carrier.
 * @property {Map<string, string>} reasons Why a carrier is left out.
 * @property {any} attitude Newest row of the method in control.
 * @property {any} samples Last hour.
 * @property {any} problem Of the last request that failed.
 */

/**
 * Keep what is shown of the carriers; `draw` is called after every change.
 * @param {{store: any, spacecraft: any}} context @param {(carriers: Carriers) => void} draw
 * @returns {() => void} Ends it.
 */
export function followCarriers({ store, spacecraft }, draw) {
  const base = `/spacecraft/${spacecraft.id}`;
  const method = spacecraft.control.method;
  const ending = new AbortController();
  const options = { signal: ending.signal };
  /** @type {Carriers} */
  const found = { plan: null, calibration: null, states: new Map(), reasons: new Map(), attitude: null, samples: null, problem: null };
  let timer = 0;
  let isBusy = false;
  let isStale = true;
  let sampledAt = -Infinity;
  /** Number in force when the calibration was asked for; at first none was. */
  let calibratedAs = NaN;

  async function renew() {
    const [rows, attitude] = await Promise.all([get(`${base}/measurements`, {}, options), get(`${base}/attitude`, { method }, options)]);
    const measured = store.get().measurement?.plan_id;
    if (!found.plan || (measured && measured !== found.plan.plan_id)) found.plan = await get(`${base}/carriers`, { plan_id: measured }, options);
    const inForce = store.get().status?.calibration_id;
    // the results of 128 carriers are not asked for with each row
    if (inForce !== calibratedAs) {
      const { rows: known } = await get(`${base}/calibrations`, {}, options);
      found.calibration = known.find((each) => each.id === inForce) ?? known.find(({ state }) => state === "active") ?? null;
      calibratedAs = inForce;
    }
    found.states = new Map(rows.map((each) => [each.carrier, each]));
    found.reasons = new Map(attitude.excluded.map((each) => [each.carrier, each.reason]));
    found.attitude = attitude;
  }

  async function sample() {
    const present = presentOf(store.get());
    if (!Number.isFinite(present) || performance.now() - sampledAt < SAMPLES_EACH_MS) return;
    sampledAt = performance.now();
    found.samples = await sampled({ spacecraft, start: present - HOUR_MS, stop: present, count: 60 }, options);
  }

  async function load() {
    isStale = false;
    try {
      await renew();
      draw(found);
      await sample();
      found.problem = null;
    } catch (error) {
      if (ending.signal.aborted) return;
      found.problem = error;
    }
    draw(found);
  }

  /** Load at once, then with each row, but once a second: 128 carriers come ten times a second. */
  async function ask() {
    isStale = true;
    if (isBusy || ending.signal.aborted) return;
    isBusy = true;
    while (isStale && !ending.signal.aborted) {
      await load();
      await new Promise((resolve) => (timer = setTimeout(resolve, STATES_EACH_MS)));
    }
    isBusy = false;
  }

  /** Plan and calibration may be of rows that are no more. */
  function begin() {
    found.plan = null;
    calibratedAs = NaN;
    ask();
  }

  const ends = [store.on("attitude", ask), store.on("dropped", begin), store.subscribe((state) => state.status?.calibration_id, ask), store.subscribe((state) => state.status?.now, ask)];
  ask();
  return () => {
    ends.forEach((end) => end());
    ending.abort();
    clearTimeout(timer);
  };
}

/**
 * Return samples of carriers as traces: by carrier the levels and their model, the residual, C/N0.
 * @param {{spacecraft: any, carrier?: string, start: number, stop: number, count: number}} asked Instants in ms.
 * @param {{signal?: AbortSignal}} options
 */
export async function sampled({ spacecraft, carrier, start, stop, count }, options = {}) {
  const params = {
    quantity: ["power_dbm", "deviation_db", "residual_db", "c_n0_db_hz"],
    method: spacecraft.control.method,
    carrier,
    start: new Date(start).toISOString(),
    stop: new Date(stop).toISOString(),
    count,
  };
  const answer = await get(`/spacecraft/${spacecraft.id}/samples`, params, options);
  const epochs = answer.epochs.map((epoch) => new Date(epoch).getTime());
  const traces = new Map();
  for (const each of answer.series) {
    if (!traces.has(each.carrier)) traces.set(each.carrier, {});
    traces.get(each.carrier)[each.quantity] = each;
  }
  for (const of of traces.values()) of.expected_dbm = expected(of);
  return { start, stop, intervalMs: 1000 * answer.interval_s, epochs, traces };
}

/** Return the mean level of the model: it follows where level and deviation are of the same rows. */
function expected({ power_dbm: power, deviation_db: deviation }) {
  if (!power || !deviation) return null;
  const avg = power.avg.map((level, k) => (level !== null && power.n[k] === deviation.n[k] ? level - deviation.avg[k] : null));
  return { avg };
}
