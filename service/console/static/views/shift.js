/** @file Shift: what the next shift must know, what happened in the last hours and who did it, and the log. */

import { Problem, get, post } from "../api.js";
import { element, fill } from "../element.js";
import { newestFirst, soon } from "../lists/newest_first.js";
import { failure } from "../parts/problem.js";
import { SEVERITY_LEVEL, symbol } from "../parts/symbol.js";
import { sentence } from "../parts/verdict.js";
import { choice, field, foreign, row, table } from "../lists/table.js";
import { linkStateWords, meaning, number, utc, words } from "../words.js";

export const name = "shift";

const HOURS = [4, 8, 12, 24];
const MOST = 200;
const TEXT_LENGTH = 8000;

/** @param {{store: any, spacecraft: any, session: any}} context */
export function show({ store, spacecraft, session }) {
  const base = `/spacecraft/${spacecraft.id}`;
  const ending = new AbortController();
  const handover = element("div", { "aria-live": "polite" });
  const happened = element("div");
  const mayWrite = session.permissions.includes("operate");
  const log = newestFirst("/notes", (rows) => element("ol", { class: "notes" }, rows.map((note) => noteOf(note, mayWrite && correct))));
  let hours = HOURS[1];
  let corrected = null;

  async function load() {
    let host = handover;
    try {
      const read = (path) => get(`${base}/${path}`, {}, { signal: ending.signal });
      const [answer, ...present] = await Promise.all(["handover", "attitude", "control"].map(read));
      fill(handover, handoverOf(answer, ...present));
      host = happened;
      await loadEvents(answer.at);
    } catch (error) {
      if (ending.signal.aborted) return;
      if (!(error instanceof Problem)) throw error;
      fill(host, failure(error), element("button", { type: "button", onclick: load }, words("app.list.again")));
    }
  }

  /** Who may not read the audit log sees what the lists say of who did what. */
  async function loadEvents(at) {
    const wanted = hours;
    const before = (instant) => new Date(instant - wanted * 3_600_000).toISOString();
    // the log goes by the clock of the service, which is not that of the data of a simulation
    const [start, logged] = [before(new Date(at).getTime()), before(Date.now() + store.get().offsetMs)];
    const ask = (path, params = {}) => get(path, { start, order: "desc", limit: MOST, ...params }, { signal: ending.signal });
    const [alarms, commands, operations, audit] = await Promise.all([
      ask(`${base}/alarms`, { state: ["open", "shelved", "suppressed", "closed"] }),
      ask(`${base}/torques/commands`),
      ask(`${base}/operations`),
      session.permissions.includes("inspect") ? ask("/audit", { target: base, start: logged }) : { rows: [] },
    ]);
    if (wanted !== hours) return;
    const listed = [...alarms.rows.filter(({ cause }) => !cause).flatMap(alarmEvents), ...commands.rows.flatMap(commandEvents), ...operations.rows.map(operationEvent)];
    const rows = [...listed.filter((event) => event.at && event.at >= start), ...audit.rows.map(auditEvent)]
      .sort((one, other) => other.at.localeCompare(one.at));
    const columns = ["at", "what", "who"].map((each) => words(`views.shift.column.${each}`));
    const list = table(words("views.shift.happened"), columns, rows.map(({ at, what, who }) => row(utc(at), what, foreign(who))));
    fill(happened, rows.length ? list : element("p", { class: "notice" }, words("app.list.empty")));
  }

  function correct(note) {
    corrected = note.id;
    fill(about, words("views.shift.corrects", { id: note.id }), " ", element("button", { type: "button", onclick: () => ((corrected = null), fill(about)) }, words("app.dialog.cancel")));
    text.focus();
  }

  const about = element("p", { class: "detail" });
  const said = element("div", { "aria-live": "assertive" });
  const text = element("textarea", { rows: 4, maxLength: TEXT_LENGTH, required: true });
  const button = element("button", { type: "submit", class: "primary" }, words("views.shift.write"));
  async function write(event) {
    event.preventDefault();
    button.disabled = true;
    try {
      await post("/notes", { text: text.value, spacecraft_id: spacecraft.id, corrects: corrected });
      text.value = "";
      corrected = null;
      fill(about);
      fill(said);
      await log.reload();
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      // the text stays: nobody writes it twice
      fill(said, failure(error));
    } finally {
      button.disabled = false;
    }
  }
  const form = mayWrite && element("form", { onsubmit: write }, field(words("views.shift.note"), text), about, said, button);

  const renew = () => log.reload();
  const ends = [store.on("note", renew), store.on("alarm", soon(load)), store.subscribe((state) => state.link.state, (state) => state === "live" && (load(), renew()))];
  load();
  log.load({ spacecraft_id: spacecraft.id });
  const spans = choice(words("views.shift.hours"), HOURS.map((each) => [String(each), words("views.shift.last", { count: each })]), (value) => ((hours = Number(value)), load()), String(hours));
  const tools = element("div", { class: "tools" }, spans, element("button", { type: "button", onclick: () => print() }, words("views.shift.print")));
  return {
    node: element("section", { class: "shift", "aria-label": words("views.shift.title") },
      element("h1", {}, words("views.shift.title"), " ", element("span", { class: "printed" }, foreign(spacecraft.id), " ", foreign(session.name))),
      tools,
      handover,
      element("h2", {}, words("views.shift.happened")),
      happened,
      element("h2", {}, words("views.shift.log")),
      form,
      log.node),
    close() {
      ends.forEach((end) => end());
      ending.abort();
      log.close();
    },
  };
}

/** Return the page of the hand-over: what stands, first what is abnormal. */
function handoverOf(answer, newest, interlock) {
  const list = (key, rows) => [element("h2", {}, words(`views.shift.${key}`)), rows.length ? element("ul", {}, rows.map((each) => element("li", {}, each))) : element("p", { class: "detail" }, words("views.shift.none"))];
  const alarm = (each) => [symbol(SEVERITY_LEVEL[each.severity]), " ", meaning("alarms", each.condition), " ", foreign(each.thing), ` ${utc(each.raised_at)} ${words(`views.alarms.state.${each.state}`)}`];
  const { control } = answer;
  const said = sentence(answer.status, newest, interlock);
  const reasons = control.reasons.map((each) => meaning("reasons", each.code)).join("; ");
  const link = (each) => [foreign(each.id), ` ${linkStateWords(each.state)}${each.enabled ? "" : `, ${words("views.shift.disabled")}`}`, each.warnings.map(({ code, detail }) => [`; ${meaning("problems", code)} `, element("span", { lang: "en" }, foreign(detail))])];
  const source = (each) => [foreign(each.source), ` ${utc(each.newest_epoch)}; ${words("views.shift.missing", { count: each.rows_missing ?? 0 })}`];
  const ending = [
    ...answer.keys.map((each) => [foreign(each.name), ` ${utc(each.expires_at)}`]),
    answer.ephemeris && `${words("views.shift.ephemeris")} ${utc(answer.ephemeris.valid_stop)}`,
    answer.alignment && words("views.shift.aligned", { hours: number(answer.alignment.age_hours, 0) }),
  ].filter(Boolean);
  return element("div", { class: "columns" },
    element("div", {}, element("p", {}, utc(answer.at), " UTC"), element("p", {}, symbol(control.situation?.severity ?? "off"), " ", said), control.reasons.length > 1 && element("p", { class: "detail" }, reasons), list("alarms", answer.alarms.map(alarm)), list("covered", [...answer.shelved, ...answer.suppressed].map(alarm))),
    element("div", {}, list("operations", answer.operations.map((each) => [meaning("operations", each.kind), ` ${utc(each.start)} – ${each.stop ? utc(each.stop) : words("views.shift.open")} `, foreign(each.comment)])), list("links", answer.links.map(link)), list("sources", answer.sources.map(source)), list("ending", ending)));
}

const alarmName = (alarm) => [meaning("alarms", alarm.condition), " ", foreign(alarm.thing), " "];
const alarmEvents = (alarm) => [
  { at: alarm.raised_at, what: [symbol(SEVERITY_LEVEL[alarm.severity]), " ", ...alarmName(alarm), words("views.alarms.change.raised")], who: "" },
  { at: alarm.acknowledged?.at, what: [...alarmName(alarm), words("views.alarms.change.acknowledged"), " ", foreign(alarm.acknowledged?.comment)], who: alarm.acknowledged?.by },
  { at: alarm.shelved?.at, what: [...alarmName(alarm), words("views.alarms.change.shelved"), " ", foreign(alarm.shelved?.comment)], who: alarm.shelved?.by },
];
const commandEvents = (command) => [
  { at: command.prepared_at, what: [words("views.shift.prepared", { id: command.id }), " ", foreign(command.reason)], who: command.prepared_by },
  { at: command.released_at, what: words("views.shift.released", { id: command.id }), who: command.confirmed_by ?? command.prepared_by },
  { at: command.reported_at, what: words("views.shift.reported", { id: command.id, state: meaning("commands", command.state) }), who: command.reported_by },
];
const operationEvent = (operation) => ({ at: operation.start, what: [words("views.shift.operation"), " ", meaning("operations", operation.kind), " ", foreign(operation.comment)], who: "" });
const auditEvent = (entry) => ({ at: entry.at, what: [foreign(entry.action), " ", foreign(entry.target), entry.outcome === "done" ? "" : ` ${entry.outcome}`], who: entry.who });

/** Return a note; a correction names the one that it corrects. */
function noteOf(note, correct) {
  const head = [utc(note.epoch), " ", foreign(note.author), note.corrects && ` ${words("views.shift.corrects", { id: note.corrects })}`, note.tags.map((tag) => [" ", foreign(tag)])];
  const button = correct && element("button", { type: "button", onclick: () => correct(note) }, words("views.shift.correct", { id: note.id }));
  return element("li", { value: note.id }, element("p", { class: "detail" }, head), element("p", { class: "text", dir: "auto" }, foreign(note.text)), button);
}
