/** @file Pulses of a command as steps, and the angles that they lead to, by the inertia of the catalogue. */

import { element, svg } from "../element.js";
import { number, utc, words } from "../words.js";

/** x, y, z of the body, as the inertia has them. */
const AXES = ["roll", "pitch", "yaw"];
const WIDTH = 640;
const HEIGHT = 120;
const LEFT = 90;
const POINTS = 240;

/**
 * Return the change of the angles of a rigid body that pulses bring about.
 * @param {any[]} schedule @param {number[][]} inertia kg m², x roll, y pitch, z yaw. @param {number} at Milliseconds.
 * @returns {number[]} deg: roll, pitch, yaw.
 */
export function anglesAt(schedule, inertia, at) {
  const inverse = inverted(inertia);
  const twice = [0, 0, 0];
  for (const pulse of schedule) {
    const began = (at - Date.parse(pulse.start)) / 1000;
    const ended = began - pulse.duration_s;
    const square = Math.max(began, 0) ** 2 - Math.max(ended, 0) ** 2;
    AXES.forEach((axis, index) => (twice[index] += (pulse[`${axis}_n_m`] * square) / 2));
  }
  return inverse.map((row) => (row.reduce((sum, each, index) => sum + each * twice[index], 0) * 180) / Math.PI);
}

/** Return both plots; the axis of time is shared. @param {any} command @param {number[][] | null} inertia */
export function pulsePlots(command, inertia) {
  const { schedule } = command;
  const instants = [command.start, command.stop, ...schedule.map(({ start }) => start)];
  if (instants.some((at) => Number.isNaN(Date.parse(at)))) return null;
  if (schedule.length === 0) return element("p", { class: "detail" }, words("views.control.noPulses"));
  const span = [Date.parse(command.start), inertia ? horizonOf(command, inertia) : Date.parse(command.stop)];
  const torques = AXES.map((axis) => stepsOf(schedule, axis, span));
  const times = Array.from({ length: POINTS + 1 }, (_, index) => span[0] + ((span[1] - span[0]) * index) / POINTS);
  const angles = inertia && times.map((time) => anglesAt(schedule, inertia, time));
  const lines = angles && AXES.map((_, axis) => times.map((time, index) => [time, angles[index][axis]]));
  return element("figure", { class: "pulses" },
    element("figcaption", {}, AXES.map((axis) => element("span", { class: `line-${axis}` }, words(`app.axis.${axis}`)))),
    plot(torques, span, words("views.control.torque"), 4), lines && plot(lines, span, words("views.control.angle"), 3),
  );
}

/** Return until when the angles are predicted: after the last pulse the rates stay, so the change itself tells it. */
function horizonOf({ schedule, stop, predicted }, inertia) {
  const end = Date.parse(stop);
  const angles = anglesAt(schedule, inertia, end);
  const waits = AXES.map((axis, index) => [Math.abs(predicted.rate_change_deg_s[axis]), (predicted.angle_change_deg[axis] - angles[index]) / predicted.rate_change_deg_s[axis]]);
  const [rate, wait] = waits.reduce((one, other) => (other[0] > one[0] ? other : one));
  return end + 1000 * (rate > 1e-9 ? Math.min(Math.max(wait, 0), 86_400) : 0);
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

function inverted([[a, b, c], [d, e, f], [g, h, i]]) {
  const determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
  return [
    [e * i - f * h, c * h - b * i, b * f - c * e],
    [f * g - d * i, a * i - c * g, c * d - a * f],
    [d * h - e * g, b * g - a * h, a * e - b * d],
  ].map((row) => row.map((each) => each / determinant));
}
