/** @file Words of the console: sentences, names of codes, numbers and instants in the chosen language. */

export const LANGUAGES = ["en", "ru"];
const MISSING = "–";
/** Keys made of a code that the answer did not have. */
const NOT_KNOWN = /\.(null|undefined)$/;
/** Inhibitions of rows are reasons of the verdict. */
const SAME = { inhibitions: "reasons" };
const UNITS = [["day", 86400], ["hour", 3600], ["minute", 60], ["second", 1]];

let table = {};
let chosen = "en";
let plural = new Intl.PluralRules("en");
const formats = new Map();

/** Load the words of a language. @param {string} language One of LANGUAGES. */
export async function loadWords(language) {
  const answer = await fetch(`words/${language}.json`);
  table = await answer.json();
  chosen = language;
  plural = new Intl.PluralRules(language);
  formats.clear();
  document.documentElement.lang = language;
}

/** @returns {string} The chosen language. */
export function language() {
  return chosen;
}

/**
 * Return the words of a key.
 * @param {string} key Levels divided by dots. @param {Object<string, any>} values For `{name}`; `count` also chooses the plural.
 * @returns {string} The key itself where there are none.
 */
export function words(key, values = {}) {
  const found = key.split(".").reduce((level, name) => level?.[name], table);
  if (found === undefined) return NOT_KNOWN.test(key) ? MISSING : key;
  return composed(found, values);
}

/** Return the words of the state of a link; a front end of another version may have states of its own. */
export function linkStateWords(state) {
  const [key, said] = [`views.links.state.${state}`, words(`views.links.state.${state}`)];
  return said === key ? state : said;
}

/**
 * Return the words of a code of the service.
 * @param {string} group `reasons` or `inhibitions`, `states`, `statuses`, `commands`, `exclusions`, `flags`, `alarms`,
 *   `severities`, `units`, `advice`, `operations` or `problems`.
 * @param {string} code @param {"name" | "next"} part What it means, or the next step. @param {Object<string, any>} values
 * @returns {string} A code that is not known stands for itself; its next step is empty.
 */
export function meaning(group, code, part = "name", values = {}) {
  const found = table[SAME[group] ?? group]?.[code]?.[part];
  return found === undefined ? (part === "name" ? (code ?? MISSING) : "") : composed(found, values);
}

/** Return a number. @param {number | null | undefined} value @param {number} digits Behind the point. */
export function number(value, digits = 2) {
  if (!Number.isFinite(value)) return MISSING;
  return format(`number ${digits}`, {
    minimumFractionDigits: digits,
    maximumFractionDigits: digits,
    signDisplay: "negative",
    useGrouping: false,
  }).format(value);
}

/**
 * Return an instant in UTC.
 * @param {string | number | null | undefined} epoch ISO 8601, or milliseconds. @param {"both" | "date" | "time" | "minute"} part
 */
export function utc(epoch, part = "both") {
  const instant = epoch === null || epoch === undefined ? NaN : new Date(epoch).getTime();
  if (!Number.isFinite(instant)) return MISSING;
  const text = new Date(instant).toISOString();
  const [date, time] = [text.slice(0, 10), text.slice(11, 19)];
  return { both: `${date} ${time}`, date, time, minute: time.slice(0, 5) }[part];
}

/** Return a length of time in its greatest unit, and the next one where that tells. @param {number | null | undefined} seconds */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return MISSING;
  const whole = Math.round(Math.abs(seconds));
  const first = Math.max(0, UNITS.findIndex(([, size]) => whole >= size));
  const index = whole < 1 ? UNITS.length - 1 : first;
  const [unit, size] = UNITS[index];
  const rest = UNITS[index + 1];
  const count = Math.floor(whole / size);
  const more = rest && count < 10 ? Math.floor((whole - count * size) / rest[1]) : 0;
  return [[count, unit], ...(more ? [[more, rest[0]]] : [])]
    .map(([value, name]) => format(`unit ${name}`, { style: "unit", unit: name, unitDisplay: "short" }).format(value))
    .join(" ");
}

function format(name, options) {
  if (!formats.has(name)) formats.set(name, new Intl.NumberFormat(chosen, options));
  return formats.get(name);
}

function composed(found, values) {
  const text = typeof found === "object" ? (found[plural.select(values.count)] ?? found.other) : found;
  return text.replace(/\{(\w+)\}/g, (_, name) => String(values[name] ?? MISSING));
}
