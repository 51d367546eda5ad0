/** @file Archive: days of a series with rows, size and SHA-256, the span as a file in every format, gaps, and replays. */

import { Problem, address, get, remove } from "../api.js";
import { element, fill } from "../element.js";
import { ask } from "../lists/dialog.js";
import { dayInput, instantMs, writeInstant } from "../lists/instant_input.js";
import { newestFirst, soon } from "../lists/newest_first.js";
import { field, foreign, row, table } from "../lists/table.js";
import { failure } from "../parts/problem.js";
import { duration, number, utc, words } from "../words.js";

export const name = "archive";

const TABLES = ["csv", "ndjson", "parquet"];
/** Series, and the formats that each is written in. */
const FORMATS = { measurements: [...TABLES, "tdm"], attitude: [...TABLES, "aem"], torques: TABLES, references: TABLES, telemetry: TABLES, polarization: TABLES, events: TABLES, joined: TABLES };
const METHODS = ["robust", "paper"];
/** Series of one method, and those that replays write too. */
const OF_METHOD = ["attitude", "joined"], OF_REPLAYS = [...OF_METHOD, "torques"];
const DAY_MS = 86_400_000;
/** Span of an address without one. */
const DAYS = 7;
/** Of one answer: the service writes the file of a day to know its hash. */
const PAGE_DAYS = 10;
const GAPS_SHOWN = 200;
const [EARLIEST_DAY, LATEST_DAY] = ["2000-01-01", "2099-12-31"];
const COLUMNS = {
  days: ["day", "state", "rows", "bytes", "sha256", "file"],
  whole: ["series", "files"],
  gaps: ["start", "stop", "length", "missing"],
  sources: ["source", "rows", "missing"],
  replays: ["version", "span", "kind", "state", "rows", "size", "made", "actions"],
};

/** @param {{store: any, spacecraft: any, session: any, parameters: URLSearchParams, rewrite: (parameters: Object<string, string>) => void}} context */
export function show({ store, spacecraft, session, parameters, rewrite }) {
  const base = `/spacecraft/${spacecraft.id}`;
  const mayOperate = session.permissions.includes("operate");
  const given = spanOf(parameters);
  const [began, days, whole, gaps] = Array.from({ length: 4 }, () => element("div"));
  let asking = new AbortController();
  const replays = newestFirst(`${base}/replays`, (rows) => listed("replays", rows.map(replayOf)));
  const inputs = {
    ...Object.fromEntries(["first", "last"].map((key) => [key, dayInput({ required: true })])),
    series: element("select", {}, optionsOf(Object.keys(FORMATS), "series", parameters.get("series"))),
    format: element("select"),
    method: element("select", {}, optionsOf(METHODS, "method", parameters.get("method"))),
    version: element("input", { maxLength: 64, placeholder: words("views.archive.live"), value: parameters.get("version") ?? "" }),
  };
  inputs.series.addEventListener("change", () => offer(inputs.format.value));
  /** Offer what the chosen series has. */
  function offer(format, series = inputs.series.value) {
    fill(inputs.format, optionsOf(FORMATS[series], "", format));
    inputs.method.disabled = !OF_METHOD.includes(series);
    inputs.version.disabled = !OF_REPLAYS.includes(series);
  }
  const span = () => ({ start: iso(instantMs(inputs.first)), stop: iso(instantMs(inputs.last) + DAY_MS) });
  const versionOf = (series) => (OF_REPLAYS.includes(series) && inputs.version.value.trim()) || null;
  /** Parameters of the files of a series, those that it does not have left out. */
  const fileOf = (series, format, method) => ({ format, method: OF_METHOD.includes(series) ? method : null, version: versionOf(series), ...span() });
  const wanted = () => fileOf(inputs.series.value, inputs.format.value, inputs.method.value);

  function choose([start, stop]) {
    writeInstant(inputs.first, start);
    writeInstant(inputs.last, stop - DAY_MS);
    load();
  }

  /** Without a span in the address: the days up to the newest row, which need not be today's. */
  function begin() {
    if (given) return choose(given);
    return into(began, `${base}/sources`, {}, ({ rows }) => {
      const newest = Math.max(...rows.map((each) => Date.parse(each.newest_epoch)).filter(Number.isFinite));
      const stop = dayOf(Number.isFinite(newest) ? newest : Date.now() + store.get().offsetMs) + DAY_MS;
      choose([stop - DAYS * DAY_MS, stop]);
      return null;
    });
  }

  /** The address names what is shown; a span that was chosen backwards is plain enough. */
  function submit(event) {
    event.preventDefault();
    [inputs.first.value, inputs.last.value] = [inputs.first.value, inputs.last.value].sort();
    const shown = Object.entries({ ...wanted(), series: inputs.series.value }).filter(([, value]) => value !== null);
    rewrite(Object.fromEntries(shown));
    load();
  }

  function load() {
    asking.abort();
    asking = new AbortController();
    fill(began);
    const path = `${base}/archive/${inputs.series.value}`;
    const manifest = { ...wanted(), limit: PAGE_DAYS };
    into(days, `${path}:manifest`, manifest, (answer) => daysOf(path, manifest, answer));
    into(gaps, `${base}/archive/gaps`, span(), gapsOf);
    fill(whole, listed("whole", Object.keys(FORMATS).flatMap(wholeOf)));
    replays.load(span());
  }

  /** Read into a part of the page; a refusal stands there, with a button that asks again. */
  async function into(host, path, params, draw) {
    const { signal } = asking;
    fill(host, element("p", { class: "notice" }, words("views.archive.reading")));
    try {
      const answer = await get(path, params, { signal });
      if (!signal.aborted) fill(host, draw(answer));
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof Problem)) throw error;
      fill(host, failure(error), element("button", { type: "button", onclick: () => into(host, path, params, draw) }, words("app.list.again")));
    }
  }

  /** Return the days of one answer, and the button that reads the next ones below them. */
  function daysOf(path, params, { parts, next }) {
    const rest = element("div");
    const more = () => into(rest, `${path}:manifest`, { ...params, cursor: next }, (answer) => daysOf(path, params, answer));
    fill(rest, next && element("button", { type: "button", onclick: more }, words("views.archive.more")));
    return [listed("days", parts.map((part) => dayRow(path, part))), rest];
  }

  /** The address of the file is the manifest's: it names the columns that the hash is of. */
  function dayRow(path, { start, rows, bytes, sha256, closed, href }) {
    const day = utc(start, "date");
    const link = href && element("a", { href: `${address(`${path}:export`)}?${href.split("?")[1]}`, download: "", "aria-label": words("views.archive.downloadOf", { day }) }, words("views.archive.download"));
    return row(day, words(closed ? "views.archive.closed" : "views.archive.open"), number(rows, 0), number(bytes, 0), element("code", { class: "foreign" }, sha256), link);
  }

  function wholeOf(series) {
    return (OF_METHOD.includes(series) ? METHODS : [null]).map((method) => {
      const title = [words(`views.archive.series.${series}`), method && `, ${words(`views.archive.method.${method}`)}`, versionOf(series) && [", ", foreign(versionOf(series))]];
      const links = FORMATS[series].map((format) => [element("a", { href: address(`${base}/archive/${series}:export`, fileOf(series, format, method)), download: "" }, format), " "]);
      return row(title, links);
    });
  }

  function replayOf(replay) {
    const { start, stop, version, state, progress, error, method, order, calibration_id: calibration, alignment_id: alignment } = replay;
    const isDone = state === "done";
    const kind = [words(method ? `views.archive.method.${method}` : "views.archive.everyMethod"), element("p", { class: "detail" }, words(`views.archive.order.${order}`)),
      element("p", { class: "detail" }, calibration && `${words("views.archive.calibration", { id: calibration })} `, alignment ? words("views.archive.alignment", { id: alignment }) : null)];
    const became = [words(`views.archive.state.${state}`), state === "running" && [element("p", {}, element("progress", { value: progress ?? 0, max: 1, "aria-label": version })), `${number(100 * progress, 0)} %`], error && element("p", { class: "detail", lang: "en" }, foreign(error))];
    const rows = [number(replay.attitude_rows, 0), element("p", { class: "detail" }, words("views.archive.torques", { count: replay.torque_rows }))];
    const files = isDone && element("a", { href: `#/archive?${new URLSearchParams({ start, stop, series: "attitude", version, ...(method && { method }) })}` }, words("views.archive.files"));
    const away = mayOperate && element("button", { type: "button", onclick: () => deleteReplay(replay) }, words("views.archive.delete"));
    return row(foreign(version), [utc(start), element("p", {}, utc(stop))], kind, became, rows, number(replay.size_bytes / 1e6, 1), utc(replay.created_at), [files, " ", away]);
  }

  const deleteReplay = ({ id, version }) => ask({
    title: words("views.archive.deleteTitle"),
    body: element("p", {}, foreign(version), " ", words("views.archive.consequence")),
    confirm: words("views.archive.delete"),
    act: () => remove(`${base}/replays/${id}`).then(replays.reload),
  });

  const form = element("form", { class: "tools", onsubmit: submit },
    Object.entries(inputs).map(([key, input]) => field(words(`views.archive.field.${key}`), input)),
    element("button", { type: "submit", class: "primary" }, words("views.archive.show")));
  const end = store.on("job", soon(replays.reload));
  const part = (key, node, hint = null) => [element("h2", {}, words(`views.archive.part.${key}`)), node, hint && element("p", { class: "detail" }, hint)];
  offer(parameters.get("format"));
  begin();
  return {
    node: element("section", { class: "archive", "aria-label": words("views.archive.title") },
      element("h1", {}, words("views.archive.title")), !given && (parameters.has("start") || parameters.has("stop")) && element("p", { class: "notice", role: "alert" }, words("views.archive.badSpan")), form, began,
      part("days", days, words("views.archive.compare")), part("whole", whole, words("views.archive.stream")), part("gaps", gaps), part("replays", replays.node)),
    close() {
      asking.abort();
      replays.close();
      end();
    },
  };
}

const iso = (instant) => new Date(instant).toISOString();
const dayOf = (instant) => Math.floor(instant / DAY_MS) * DAY_MS;
const optionsOf = (values, group, chosen) => values.map((value) => element("option", { value, selected: value === chosen }, group ? words(`views.archive.${group}.${value}`) : value));

/** Return the whole days of the span of an address, ms; null: it names none. */
function spanOf(parameters) {
  const [start, stop] = ["start", "stop"].map((each) => Date.parse(parameters.get(each) ?? ""));
  const isSpan = start >= Date.parse(EARLIEST_DAY) && start < stop && stop <= Date.parse(LATEST_DAY) + DAY_MS;
  return isSpan ? [dayOf(start), dayOf(stop - 1) + DAY_MS] : null;
}

function listed(kind, rows) {
  if (rows.length === 0) return element("p", { class: "notice" }, words("app.list.empty"));
  return table(words(`views.archive.part.${kind}`), COLUMNS[kind].map((each) => words(`views.archive.column.${each}`)), rows);
}

/** Return the newest gaps, how many there are, and what each source sent. */
function gapsOf({ gaps, sources }) {
  const rows = gaps.slice(-GAPS_SHOWN).reverse().map(({ start, stop, rows_missing: missing }) => row(utc(start), utc(stop), duration((Date.parse(stop) - Date.parse(start)) / 1000), number(missing, 0)));
  const missing = gaps.reduce((sum, gap) => sum + gap.rows_missing, 0);
  return [
    element("p", {}, words("views.archive.gaps", { count: gaps.length, missing }), gaps.length > rows.length && ` ${words("views.archive.cut", { count: rows.length })}`),
    rows.length > 0 && listed("gaps", rows),
    element("h3", {}, words("views.archive.part.sources")), listed("sources", sources.map((source) => row(foreign(source.id), number(source.rows, 0), number(source.rows_missing, 0)))),
  ];
}
