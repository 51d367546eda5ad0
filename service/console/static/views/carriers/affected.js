/** @file Who is affected: all carriers, one transponder, one station, or single users. */

/** Names that a sentence can carry. */
export const MOST_NAMED = 5;

/** States in which a carrier brings nothing: it left the air, or the estimator found it wrong. */
const DOWN = ["absent", "excluded"];

/**
 * Return the key of the sentence, and its values.
 * @param {any[]} carriers Of the plan. @param {Map<string, any>} states @param {any} attitude Newest row; null where there is none.
 * @returns {{kind: string, level: string, count: number, total: number, name: string, ids: string[], common: number}}
 */
export function affected(carriers, states, attitude) {
  const held = carriers.filter((carrier) => states.has(carrier.id));
  const down = held.filter((carrier) => DOWN.includes(states.get(carrier.id)?.state));
  const ids = down.map((carrier) => carrier.id);
  const common = attitude?.downlink_fade ? -(attitude.downlink_fade_db ?? 0) : (attitude?.common_db ?? 0);
  const found = { count: down.length, total: held.length, name: "", ids, common };
  if (!held.length) return { kind: "waiting", level: "off", ...found };
  if (attitude?.downlink_fade || attitude?.inhibitions?.includes("common_change")) return { kind: "common", level: "serious", ...found };
  if (!down.length) {
    // without a calibration nothing says what is expected
    const isKnown = held.some((carrier) => states.get(carrier.id).state === "used");
    return { ...found, kind: isKnown ? "none" : "present", level: isKnown ? "normal" : "off", count: held.length };
  }
  if (down.length === held.length && held.length > 1) return { kind: "all", level: "critical", ...found };
  for (const [kind, nameOf] of GROUPS) {
    const name = nameOf(down[0]);
    const members = held.filter((carrier) => nameOf(carrier) === name);
    const isAll = name && members.length > 1 && members.length === down.length && down.every((carrier) => nameOf(carrier) === name);
    if (isAll) return { kind, level: "serious", ...found, name };
  }
  return { kind: down.length === 1 ? "one" : "some", level: "caution", ...found };
}

/** @type {[string, (carrier: any) => string | undefined][]} */
const GROUPS = [["station", (carrier) => carrier.station?.name], ["transponder", (carrier) => carrier.transponder]];
