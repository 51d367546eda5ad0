/** @file States of the interlock as a diagram: the present one is marked, and the ways that lead out of it. */

import { element, svg } from "../element.js";
import { meaning, words } from "../words.js";

/** Changes of state by trigger, as `service/pipeline/control/release/interlock_states.py` has them; a test compares. */
export const WAYS = [
  ["INHIBITED", "TRIP", "TRIPPED"],
  ["INHIBITED", "CLEAR", "RECOVERY"],
  ["INHIBITED", "CLEAR", "ENGAGED"],
  ["INHIBITED", "CLEAR", "ARMED"],
  ["INHIBITED", "ARM", "RECOVERY"],
  ["INHIBITED", "ARM", "ARMED"],
  ["ARMED", "TRIP", "TRIPPED"],
  ["ARMED", "INHIBIT", "BALANCE"],
  ["ARMED", "INHIBIT", "INHIBITED"],
  ["ARMED", "BEYOND", "RECOVERY"],
  ["ARMED", "ENGAGE", "ENGAGED"],
  ["ARMED", "DISENGAGE", "INHIBITED"],
  ["ENGAGED", "TRIP", "TRIPPED"],
  ["ENGAGED", "INHIBIT", "BALANCE"],
  ["ENGAGED", "INHIBIT", "INHIBITED"],
  ["ENGAGED", "BEYOND", "RECOVERY"],
  ["ENGAGED", "EXPIRE", "ARMED"],
  ["ENGAGED", "DISENGAGE", "ARMED"],
  ["RECOVERY", "TRIP", "TRIPPED"],
  ["RECOVERY", "INHIBIT", "BALANCE"],
  ["RECOVERY", "INHIBIT", "INHIBITED"],
  ["RECOVERY", "WITHIN", "ARMED"],
  ["RECOVERY", "DISENGAGE", "INHIBITED"],
  ["BALANCE", "TRIP", "TRIPPED"],
  ["BALANCE", "LAPSE", "INHIBITED"],
  ["BALANCE", "CLEAR", "RECOVERY"],
  ["BALANCE", "CLEAR", "ENGAGED"],
  ["BALANCE", "CLEAR", "ARMED"],
  ["BALANCE", "DISENGAGE", "INHIBITED"],
  ["TRIPPED", "RESET", "INHIBITED"],
];
const WIDTH = 118;
const HEIGHT = 30;
/** Middles of the states. */
const PLACES = { TRIPPED: [70, 90], INHIBITED: [235, 90], ARMED: [400, 90], ENGAGED: [400, 20], RECOVERY: [400, 160], BALANCE: [235, 160] };

/** Return the diagram, and what leads out of the present state in words. @param {string} state */
export function stateDiagram(state) {
  const pairs = [...new Set(WAYS.map(([from, , to]) => `${from} ${to}`))].map((pair) => pair.split(" "));
  const lines = pairs.map(([from, to]) => arrow(from, to, from === state));
  const nodes = Object.entries(PLACES).map(([name, [x, y]]) =>
    svg("g", { class: name === state ? "state present" : "state" },
      svg("rect", { x: x - WIDTH / 2, y: y - HEIGHT / 2, width: WIDTH, height: HEIGHT, rx: 4 }),
      svg("text", { x, y: y + 4, "text-anchor": "middle" }, name),
    ),
  );
  const label = words("views.control.diagram", { state: meaning("states", state) });
  const drawing = svg("svg", { class: "states", viewBox: "0 0 470 180", role: "img", "aria-label": label }, lines, nodes);
  const out = WAYS.filter(([from]) => from === state);
  const ways = [...new Set(out.map(([, trigger]) => trigger))].map((trigger) => {
    const targets = out.filter(([, each]) => each === trigger).map(([, , to]) => to);
    return element("li", {}, words(`views.control.triggers.${trigger}`), " → ", targets.join(", "));
  });
  return [drawing, element("h2", {}, words("views.control.ways")), element("ul", { class: "ways" }, ways)];
}

/** Return an arrow from edge to edge; there and back are side by side. */
function arrow(from, to, isOpen) {
  const [a, b] = [PLACES[from], PLACES[to]];
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = Math.hypot(dx, dy);
  const side = [(-dy / length) * 5, (dx / length) * 5];
  const edge = (middle, sign, gap) => {
    const way = [(sign * dx) / length, (sign * dy) / length];
    const reach = [WIDTH / 2, HEIGHT / 2].map((half, axis) => (way[axis] ? (half - Math.sign(way[axis]) * side[axis]) / Math.abs(way[axis]) : Infinity));
    return [0, 1].map((axis) => middle[axis] + side[axis] + way[axis] * (Math.min(...reach) + gap));
  };
  const [start, stop] = [edge(a, 1, 0), edge(b, -1, 2)];
  const head = [0.4, -0.4].map((turn) => {
    const angle = Math.atan2(dy, dx) + Math.PI + turn;
    return [stop[0] + 7 * Math.cos(angle), stop[1] + 7 * Math.sin(angle)];
  });
  const points = [start, stop, head[0], stop, head[1]].map((point) => point.map((each) => each.toFixed(1)).join(",")).join(" ");
  return svg("polyline", { points, class: isOpen ? "way open" : "way" });
}
