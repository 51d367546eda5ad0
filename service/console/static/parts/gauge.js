/** @file One axis as an analog scale: limits in force, needle, two sigma, protection level, other method, last hour. */

import { element, setText, svg } from "../element.js";
import { duration, number, words } from "../words.js";

const WIDTH = 380;
const HALF = 170;
const HOUR_MS = 3_600_000;
const BINS = 120;
const BIN_MS = HOUR_MS / BINS;
/** Without limits the scale shows so much, deg. */
const PLAIN_DEG = 0.5;
/** The scale goes beyond its limit by this factor. */
const ROOM = 1.25;
/** The least height of the curve of the last hour, deg: below it, it shows noise. */
const LEAST_SPAN_DEG = 0.02;

/**
 * @typedef {Object} AxisState
 * @property {number | null} angle deg
 * @property {number | null} sigma deg
 * @property {number | null} protection deg
 * @property {number | null} other Angle of the other method, deg.
 * @property {any} motion What the service found of its way to the limit; null: nothing is known of it.
 * @property {number | null} limit Greatest angle, deg.
 * @property {number | null} alert Greatest protection level, deg.
 * @property {boolean} isStale
 * @property {number} age s
 */

/** Return the gauge of an axis. @param {string} axis */
export function gauge(axis) {
  const [low, high] = [svg("rect", { class: "beyond", y: 18, height: 40 }), svg("rect", { class: "beyond", y: 18, height: 40 })];
  const sigma = svg("rect", { class: "sigma", y: 30, height: 16 });
  const levels = svg("path", { class: "level" });
  const needle = svg("path", { class: "needle" });
  const other = svg("path", { class: "other" });
  const labels = [-1, 0, 1].map(() => svg("text", { y: 94 }));
  const ticks = svg("path", { class: "ticks" });
  const scale = svg("svg", { class: "scale", viewBox: `0 0 ${WIDTH} 98`, role: "img" }, svg("defs", {}, hatch(axis)), [low, high],
    svg("path", { class: "line", d: `M${WIDTH / 2 - HALF} 38h${2 * HALF}` }), ticks, sigma, levels, other, needle, labels,
    svg("rect", { class: "stale", width: WIDTH, height: 98, fill: `url(#hatch-${axis})` }),
  );
  const hour = lastHour();
  const value = element("span", { class: "value" });
  const unit = element("span", { class: "unit" }, words("app.unit.deg"));
  const rate = element("dd", {});
  const toLimit = element("dd", {});
  const sigmaText = element("dd", {});
  const protection = element("dd", {});
  const otherText = element("dd", {});
  const age = element("p", { class: "age" });
  const entry = (name, node) => element("div", {}, element("dt", {}, words(`views.now.${name}`)), node);
  const facts = element("dl", {},
    [entry("rate", rate), entry("toLimit", toLimit), entry("sigma", sigmaText), entry("protection", protection), entry("otherMethod", otherText)],
  );
  const node = element("section", { class: "gauge", "aria-label": words(`app.axis.${axis}`) }, element("h2", {}, words(`app.axis.${axis}`)),
    element("p", { class: "reading" }, value, " ", unit), age, scale, facts, hour.node,
  );

  /** @param {AxisState} state */
  function draw(state) {
    const reach = (state.limit ?? PLAIN_DEG) * (state.limit ? ROOM : 1);
    const at = (angle) => WIDTH / 2 + (HALF * Math.max(-reach, Math.min(reach, angle))) / reach;
    const isKnown = Number.isFinite(state.angle);
    const isBeyond = isKnown && state.motion?.beyond === true;
    drawScale(state, reach, at);
    show(sigma, isKnown && Number.isFinite(state.sigma));
    if (isKnown && Number.isFinite(state.sigma)) span(sigma, at(state.angle - 2 * state.sigma), at(state.angle + 2 * state.sigma));
    drawLevel(state, at);
    show(needle, isKnown);
    if (isKnown) needle.setAttribute("d", `M${at(state.angle)} 22v32M${at(state.angle) - 8} 8h16l-8 14z`);
    show(other, Number.isFinite(state.other));
    if (Number.isFinite(state.other)) other.setAttribute("d", `M${at(state.other) - 6} 66h12l-6 -11z`);
    setText(value, number(state.angle, 3));
    setText(rate, `${number(state.motion?.rate_deg_h, 3)} ${words("app.unit.deg_h")}`);
    setText(toLimit, wayText(state.motion));
    setText(sigmaText, Number.isFinite(state.sigma) ? `±${number(2 * state.sigma, 3)}` : number(null));
    const alert = Number.isFinite(state.alert) ? words("views.now.ofAlert", { alert: number(state.alert, 2) }) : "";
    setText(protection, `${number(state.protection, 3)} ${alert}`);
    setText(otherText, number(state.other, 3));
    const stale = Number.isFinite(state.age) ? words(isKnown ? "views.now.stale" : "views.now.noAngle", { age: duration(state.age) }) : words("views.now.noRow");
    setText(age, state.isStale ? stale : "");
    node.classList.toggle("is-stale", state.isStale);
    node.classList.toggle("is-beyond", isBeyond);
    needle.classList.toggle("critical", isBeyond);
    scale.setAttribute("aria-label", words("views.now.scale", { axis: words(`app.axis.${axis}`), angle: number(state.angle, 3), limit: number(state.limit, 2) }));
    hour.draw(state.limit);
  }

  function drawScale({ limit }, reach, at) {
    const shown = Number.isFinite(limit) ? limit : reach;
    [-shown, 0, shown].forEach((angle, index) => {
      labels[index].setAttribute("x", String(at(angle)));
      setText(labels[index], number(angle, angle === 0 ? 0 : 2));
    });
    ticks.setAttribute("d", [-shown, -shown / 2, 0, shown / 2, shown].map((angle) => `M${at(angle)} 30v16`).join(""));
    for (const rect of [low, high]) show(rect, Number.isFinite(limit));
    span(low, at(-reach), at(-shown));
    span(high, at(shown), at(reach));
  }

  function drawLevel({ angle, protection: level, alert }, at) {
    const isShown = Number.isFinite(angle) && Number.isFinite(level);
    show(levels, isShown);
    if (!isShown) return;
    const [left, right] = [at(angle - level), at(angle + level)];
    levels.setAttribute("d", `M${left} 70v8M${left} 74H${right}M${right} 70v8`);
    levels.classList.toggle("caution", Number.isFinite(alert) && level > alert);
  }

  return { node, draw, push: hour.push, renew: hour.renew };
}

/** Return the words of the way to a limit; a rate without a time does not lead there. */
function wayText(motion) {
  if (motion?.beyond) return words("views.now.beyond");
  const isAway = Number.isFinite(motion?.rate_deg_h) && !Number.isFinite(motion.hours_to_limit);
  return isAway ? words("views.now.never") : duration(3600 * (motion?.hours_to_limit ?? NaN));
}

/** Return the curve of the last hour: mean of half a minute each, however many rows come. */
function lastHour() {
  const bins = new Map();
  const curve = svg("path", { class: "curve" });
  const limits = svg("path", { class: "limit" });
  const [top, bottom, title] = ["top", "bottom", "title"].map((name) => element("span", { class: name }));
  // the plot takes what room there is; its texts keep their size
  const plot = svg("svg", { viewBox: `0 0 ${WIDTH} 160`, preserveAspectRatio: "none" }, limits, curve);
  const node = element("div", { class: "hour", role: "img", "aria-label": words("views.now.lastHour") }, plot, top, bottom, title);
  let newest = 0;

  /** Forget all rows, and the newest bin too: an archive that was set back begins before it. */
  function renew() {
    bins.clear();
    newest = 0;
  }

  function push(epochMs, angle) {
    const bin = Math.floor(epochMs / BIN_MS);
    newest = Math.max(newest, bin);
    if (!Number.isFinite(angle)) return;
    const { sum, n } = bins.get(bin) ?? { sum: 0, n: 0 };
    bins.set(bin, { sum: sum + angle, n: n + 1 });
    for (const old of bins.keys()) if (old <= newest - BINS) bins.delete(old);
  }

  function draw(limit) {
    const points = [...bins].sort(([one], [next]) => one - next).map(([bin, { sum, n }]) => [bin, sum / n]);
    const angles = points.map(([, angle]) => angle);
    const [least, greatest] = angles.length ? [Math.min(...angles), Math.max(...angles)] : [0, 0];
    const middle = (least + greatest) / 2;
    const half = Math.max(greatest - least, LEAST_SPAN_DEG) * 0.6;
    const x = (bin) => WIDTH - (newest - bin) * (WIDTH / BINS);
    const y = (angle) => 80 - (76 * (angle - middle)) / half;
    // a gap of more than five minutes is no line
    const path = points.map(([bin, angle], index) => `${index && bin - points[index - 1][0] <= 10 ? "L" : "M"}${x(bin)} ${y(angle)}`);
    curve.setAttribute("d", path.join(""));
    const inSight = [-1, 1].map((sign) => sign * (limit ?? NaN)).filter((angle) => Math.abs(angle - middle) < half);
    limits.setAttribute("d", inSight.map((angle) => `M0 ${y(angle)}H${WIDTH}`).join(""));
    setText(title, words(angles.length ? "views.now.lastHour" : "views.now.emptyHour"));
    setText(top, angles.length ? number(middle + half, 3) : "");
    setText(bottom, angles.length ? number(middle - half, 3) : "");
  }

  return { node, push, draw, renew };
}

function hatch(axis) {
  return svg("pattern", { id: `hatch-${axis}`, width: 8, height: 8, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, svg("path", { class: "hatch", d: "M0 0v8" }));
}

function show(node, isShown) {
  node.toggleAttribute("data-hidden", !isShown);
}

function span(rect, left, right) {
  rect.setAttribute("x", String(left));
  rect.setAttribute("width", String(Math.max(0, right - left)));
}
