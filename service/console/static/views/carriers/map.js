/**
 * @file The stations as the satellite sees them, North up and East right: directions are computed, nothing is loaded.
 *
 * An arrow shows where a station must move in this picture for its level to rise. Positive roll moves stations South,
 * positive pitch West, so the rise to the East is minus the sensitivity to pitch, that to the North minus that to roll.
 */

import { svg } from "../../element.js";
import { number, words } from "../../words.js";

const EARTH_KM = 6378.137;
const ORBIT_KM = 42_164;
const RADIANS = Math.PI / 180;
/** Of the Earth, seen from the orbit, deg. */
const LIMB_DEG = Math.asin(EARTH_KM / ORBIT_KM) / RADIANS;
const STEP_DEG = 15;
/** More names than these would cover each other. */
const MOST_NAMES = 24;
/** Width of the picture, and length of the longest arrow in it. */
const WIDTH = 20;
const LONGEST = 2;
/** The picture shows no less, deg. */
const LEAST_DEG = 4;

/**
 * Return the direction of a place from the satellite, degrees East and North; null where the Earth hides it.
 * @param {number} latitudeDeg @param {number} eastDeg Longitude less that of the satellite.
 */
export function seen(latitudeDeg, eastDeg) {
  const [latitude, longitude] = [latitudeDeg * RADIANS, eastDeg * RADIANS];
  const toward = Math.cos(latitude) * Math.cos(longitude);
  if (toward < EARTH_KM / ORBIT_KM) return null;
  const [east, north, down] = [Math.cos(latitude) * Math.sin(longitude), Math.sin(latitude), ORBIT_KM / EARTH_KM - toward];
  return { east: Math.atan2(east, down) / RADIANS, north: Math.atan2(north, Math.hypot(east, down)) / RADIANS };
}

/**
 * Return the map.
 * @param {{longitudeDeg: number, carriers: any[], calibration: any, levelOf: (id: string) => string, chosen?: string}} options
 */
export function carrierMap({ longitudeDeg, carriers, calibration, levelOf, chosen }) {
  const sensitivity = new Map((calibration?.carriers ?? []).map((each) => [each.id, each.sensitivity_db_per_deg]));
  const stations = carriers
    .filter((carrier) => carrier.station)
    .map((carrier) => ({ carrier, at: seen(carrier.station.latitude_deg, carrier.station.longitude_deg - longitudeDeg) }))
    .filter(({ at }) => at !== null);
  const arrows = stations.map((each) => ({ ...each, rise: riseOf(sensitivity.get(each.carrier.id)) })).filter(({ rise }) => rise);
  const greatest = arrows.reduce((most, { rise }) => Math.max(most, Math.hypot(rise.east, rise.north)), 1e-9);
  const count = stations.length;
  const look = lookAt(stations.map(({ at }) => at));
  const label = words("views.carriers.map.label", { count, arrows: arrows.length });
  return svg("svg", { class: "map", viewBox: `${-WIDTH / 2} ${-WIDTH / 2} ${WIDTH} ${WIDTH}`, role: "img", "aria-label": label },
    svg("circle", { class: "earth", cx: look.x(0), cy: look.y(0), r: LIMB_DEG * look.scale }), graticule(longitudeDeg, look),
    arrows.map((each) => arrow(each, look, LONGEST / greatest)),
    stations.map((each) => station(each, look, levelOf(each.carrier.id), each.carrier.id === chosen, count <= MOST_NAMES)),
    arrows.length > 0 && svg("text", { x: 0.3 - WIDTH / 2, y: WIDTH / 2 - 0.4 }, words("views.carriers.map.scale", { greatest: number(greatest, 1) })),
  );
}

/** Return the picture that holds all stations: scale, and coordinates of directions. */
function lookAt(directions) {
  const range = (values) => [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
  const [west, east] = directions.length ? range(directions.map((at) => at.east)) : [-LIMB_DEG, LIMB_DEG];
  const [south, north] = directions.length ? range(directions.map((at) => at.north)) : [-LIMB_DEG, LIMB_DEG];
  // arrows and names need room
  const scale = (WIDTH - 2 * LONGEST - 1.5) / Math.max(LEAST_DEG, east - west, north - south);
  return { scale, x: (at) => scale * (at - (west + east) / 2), y: (at) => -scale * (at - (south + north) / 2) };
}

function riseOf(sensitivity) {
  const { roll, pitch } = sensitivity ?? {};
  return Number.isFinite(roll) && Number.isFinite(pitch) ? { east: -pitch, north: -roll } : null;
}

function arrow({ at, rise }, look, scale) {
  const [x, y] = [look.x(at.east), look.y(at.north)];
  const [dx, dy] = [rise.east * scale, -rise.north * scale];
  const length = Math.hypot(dx, dy) || 1;
  const [ux, uy] = [(0.22 * dx) / length, (0.22 * dy) / length];
  const head = `M${x + dx} ${y + dy}L${x + dx - ux - uy} ${y + dy - uy + ux}M${x + dx} ${y + dy}L${x + dx - ux + uy} ${y + dy - uy - ux}`;
  return svg("path", { class: "arrow", d: `M${x} ${y}L${x + dx} ${y + dy}${head}` });
}

function station({ carrier, at }, look, level, isChosen, hasName) {
  const [x, y] = [look.x(at.east), look.y(at.north)];
  const name = [carrier.id, carrier.station.name].filter(Boolean).join(" · ");
  // abnormal ones differ by shape too
  const isAbnormal = level !== "normal" && level !== "off";
  const shape = isAbnormal ? svg("path", { class: `mark ${level}`, d: `M${x} ${y - 0.3}l0.3 0.3l-0.3 0.3l-0.3 -0.3Z` }) : svg("circle", { class: "mark", cx: x, cy: y, r: 0.16 });
  return svg("g", {}, svg("title", {}, name), isChosen && svg("circle", { class: "chosen", cx: x, cy: y, r: 0.5 }), shape,
    (hasName || isChosen || isAbnormal) && svg("text", { x, y: y - 0.4, "text-anchor": "middle" }, carrier.id),
  );
}

function graticule(longitudeDeg, look) {
  const steps = (from, to, by) => Array.from({ length: Math.round((to - from) / by) + 1 }, (_, k) => from + k * by);
  const first = Math.ceil((longitudeDeg - 90) / STEP_DEG) * STEP_DEG;
  const meridians = steps(first, first + 180, STEP_DEG).map((longitude) => steps(-90, 90, 3).map((latitude) => seen(latitude, longitude - longitudeDeg)));
  const parallels = steps(-75, 75, STEP_DEG).map((latitude) => steps(-90, 90, 3).map((east) => seen(latitude, east)));
  return svg("path", { class: "graticule", d: [...meridians, ...parallels].map((points) => polyline(points, look)).join("") });
}

/** Return the path of a line, with breaks where it is hidden. */
function polyline(points, look) {
  let isBroken = true;
  return points
    .map((at) => {
      const step = at && `${isBroken ? "M" : "L"}${look.x(at.east).toFixed(2)} ${look.y(at.north).toFixed(2)}`;
      isBroken = at === null;
      return step ?? "";
    })
    .join("");
}
