/** @file Pulses of a command as steps, and the angles that the service predicts of them. */

import { AXES } from "../api.js";
import { element, svg } from "../element.js";
import { number, utc, words } from "../words.js";

const WIDTH = 640;
const HEIGHT = 120;
const LEFT = 90;

/** Return both plots; the axis of time is shared. @param {any} command */
export function pulsePlots({ start, stop, schedule, predicted_angles: predicted }) {
  if ([start, stop, ...schedule.map((pulse) => pulse.start)].some((at) => Number.isNaN(Date.parse(at)))) return null;
  if (schedule.length === 0) return element("p", { class: "detail" }, words("views.control.noPulses"));
  const angles = (predicted ?? []).map((each) => ({ ...each, at: Date.parse(each.at) })).filter(({ at }) => Number.isFinite(at));
  const span = [Date.parse(start), angles.at(-1)?.at ?? Date.parse(stop)];
  const torques = AXES.map((axis) => stepsOf(schedule, axis, span));
  const lines = AXES.map((axis) => angles.map(({ at, angle_change_deg: change }) => [at, change?.[axis]]).filter(([, angle]) => Number.isFinite(angle)));
  return element("figure", { class: "pulses" },
    element("figcaption", {}, AXES.map((axis) => element("span", { class: `line-${axis}` }, words(`app.axis.${axis}`)))),
    plot(torques, span, words("views.control.torque"), 4), angles.length > 0 && plot(lines, span, words("views.control.angle"), 3),
  );
}

function stepsOf(schedule, axis, [start, stop]) {
  const edges = schedule.flatMap((pulse) => {
    const [began, torque] = [Date.parse(pulse.start), pulse[`${axis}_n_m`]];
    const ended = began + 1000 * pulse.duration_s;
    return torque ? [[began, 0], [began, torque], [ended, torque], [ended, 0]] : [];
  });
  return [[start, 0], ...edges, [stop, 0]];
}

function plot(lines, [start, stop], label, digits) {
  const values = lines.flat().map(([, value]) => value);
  const [low, high] = [Math.min(0, ...values), Math.max(0, ...values)];
  const room = 0.08 * (high - low || 1);
  const x = (time) => LEFT + ((WIDTH - LEFT) * (time - start)) / (stop - start);
  const y = (value) => HEIGHT - 16 - ((HEIGHT - 34) * (value - low + room)) / (high - low + 2 * room);
  const marks = [...new Set([low, 0, high])].map((value) => [
    svg("line", { class: "grid", x1: LEFT, x2: WIDTH, y1: y(value), y2: y(value) }),
    svg("text", { x: LEFT - 4, y: y(value) + 4, "text-anchor": "end" }, number(value, digits)),
  ]);
  const ends = [[start, "start"], [stop, "end"]].map(([time, anchor]) => svg("text", { x: x(time), y: HEIGHT - 2, "text-anchor": anchor }, utc(time, "time")));
  const drawn = lines.map((line, index) =>
    svg("polyline", { class: `line-${AXES[index]}`, points: line.map(([time, value]) => `${x(time).toFixed(1)},${y(value).toFixed(1)}`).join(" ") }),
  );
  return svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label }, svg("text", { x: LEFT, y: 10 }, label), marks, ends, drawn);
}
