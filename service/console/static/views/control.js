/** @file Control: state and conditions, orders, a command from its dry run to its report, and what was sent before. */

import { AXES, Problem, get, post } from "../api.js";
import { element, fill, onFrame } from "../element.js";
import { instantInput, instantText } from "../lists/instant_input.js";
import { commandFacts, commandHistory, owedCommand, waitingCommand } from "../parts/command.js";
import { conditions } from "../parts/conditions.js";
import { failure } from "../parts/problem.js";
import { stateDiagram } from "../parts/state_diagram.js";
import { symbol } from "../parts/symbol.js";
import { meaning, number, utc, words } from "../words.js";

export const name = "control";
const HISTORY_MS = 30 * 86_400_000;
const MOST = 10_000;
const SHOWN = 50;
/** Commands end by their time, which no event may tell. */
const AGAIN_MS = 10_000;
const SOON_MS = 2000;

/** @param {{store: any, spacecraft: any, session: any}} context */
export function show({ store, spacecraft, session }) {
  const path = `/spacecraft/${spacecraft.id}`;
  const may = (permission) => session.permissions.includes(permission);
  const [verdict, diagram, table, standing, commands, history] = Array.from({ length: 6 }, () => element("div"));
  const closing = new AbortController();
  let drawn = "";
  let timer = 0;

  /** Order something and show what was answered; true where it was done. */
  async function run(act, said, wordsOf = doneWords) {
    const buttons = [...node.querySelectorAll("button")].filter((each) => !each.disabled);
    for (const each of buttons) each.disabled = true;
    fill(said, element("p", { role: "status" }, words("views.control.asking")));
    try {
      const answer = await act();
      fill(said, element("p", { role: "status" }, symbol("normal"), " ", wordsOf(answer)));
      await refresh();
      return true;
    } catch (error) {
      if (closing.signal.aborted) return false;
      fill(said, failure(error instanceof Problem ? error : new Problem({ detail: String(error) })));
      // what the order was held against may have changed
      await refresh();
      return false;
    } finally {
      for (const each of buttons) each.disabled = false;
    }
  }

  const said = element("div", { class: "said" });

  /** Read everything; true where the service answered. */
  async function refresh() {
    try {
      const [control, { now }] = await Promise.all([get(`${path}/control`), get(`${path}/status`)]);
      const start = now && new Date(Date.parse(now) - HISTORY_MS).toISOString();
      const pending = [...control.open_commands, ...control.unreported_commands];
      const [page, ...waiting] = await Promise.all([
        get(`${path}/torques/commands`, { start, limit: MOST }),
        ...pending.map((id) => get(`${path}/torques/${id}`)),
      ]);
      if (closing.signal.aborted) return true;
      store.set({ control });
      drawCommands(waiting, page.rows);
      fill(lost);
      return true;
    } catch (error) {
      if (!closing.signal.aborted) fill(lost, failure(error instanceof Problem ? error : new Problem({ detail: String(error) })));
      return false;
    }
  }

  async function keepFresh() {
    const isAnswered = await refresh();
    if (!closing.signal.aborted) timer = setTimeout(keepFresh, isAnswered ? AGAIN_MS : SOON_MS);
  }

  function drawControl() {
    const { control } = store.get();
    if (!control) return;
    const { allowed, state, reasons } = control.control;
    const title = allowed ? "allowed" : state === "BALANCE" ? "balance" : "forbidden";
    const [worst, ...others] = reasons;
    const why = allowed || !worst ? meaning("states", control.state) : `${meaning("reasons", worst.code)}; ${meaning("reasons", worst.code, "next")}`;
    fill(verdict, element("h1", {}, symbol(control.control.situation?.severity ?? "off"), " ", words(`views.control.${title}`), " – ", why));
    const since = control.since && words("views.control.sinceState", { at: utc(control.since) });
    verdict.append(element("p", { class: "detail" }, [since, ...(allowed ? reasons : others).map(({ code }) => meaning("reasons", code))].filter(Boolean).join("; ")));
    fill(diagram, stateDiagram(control.state));
    const wasOpen = table.querySelector("details")?.open;
    fill(table, conditions(control));
    if (wasOpen) table.querySelector("details").open = true;
    fill(standing, standingFacts(control));
    const { requested_by: first, requested_until: until } = control;
    // the second person must ask for the same end
    const join = () => run(() => post(`${path}/control:engage`, { until }), said);
    const isJoining = first && first !== session.name && may("approve");
    if (isJoining) standing.append(element("button", { type: "button", class: "primary", onclick: join }, words("views.control.join", { until: utc(until) })));
  }

  /** Draw commands anew only where one has changed: somebody may be writing in a form. */
  function drawCommands(waiting, all) {
    const key = JSON.stringify([waiting, all].map((list) => list.map(({ id, state }) => [id, state])));
    if (key === drawn) return;
    drawn = key;
    const card = (command) => (command.state === "PREPARED" ? waitingCommand : owedCommand)(command, { spacecraft, session }, run);
    fill(commands, waiting.map(card));
    fill(history, element("h2", {}, words("views.control.history")), commandHistory(all.slice(-SHOWN), spacecraft));
  }

  const lost = element("div");
  const node = element("section", { class: "control-view", "aria-label": words("views.control.title") },
    element("div", { class: "control-state" }, element("div", { role: "status" }, verdict), lost, said, commands, may("operate") && orders(path, may, run, said), may("operate") && prepareForm(path, run), standing),
    element("div", { class: "control-conditions" }, diagram, element("h2", {}, words("views.control.conditions")), table),
    element("div", { class: "control-history" }, history),
  );
  const draw = onFrame(drawControl);
  const ends = [store.subscribe((state) => state.control, draw), store.on("command", refresh), store.on("dropped", refresh)];
  drawControl();
  keepFresh();
  return {
    node,
    close() {
      closing.abort();
      clearTimeout(timer);
      ends.forEach((end) => end());
    },
  };
}

/** Say what an order has led to: a command, or a state of control. */
function doneWords(answer) {
  if (answer.dry_run) return words("views.control.done.dryRun");
  if (answer.checks) return words("views.control.done.command", { id: answer.id, state: meaning("commands", answer.state) });
  return words("views.control.done.control", { state: meaning("states", answer.state) });
}

function standingFacts(control) {
  const { envelope, sent_impulse_n_m_s: sent, sign_check: check } = control;
  const facts = [
    ["release", words(`views.control.releases.${control.release}`)],
    ["mode", words(`views.control.modes.${control.mode}`)],
    ["armed", words(control.armed ? "views.control.yes" : "views.control.no")],
    control.requested_by && ["requested", [element("bdi", {}, control.requested_by), ` – ${utc(control.requested_until)}`]],
    control.authorised_by.length > 0 && ["authorised", [control.authorised_by.map((each, index) => [index ? " + " : "", element("bdi", {}, each)]), ` – ${utc(control.authorised_until)}`]],
    ["envelope", words("views.control.envelope", { angle: number(envelope.angle_change_deg, 3), rate: number(envelope.rate_change_deg_s, 5), impulse: number(envelope.impulse_n_m_s, 3), hour: number(envelope.impulse_an_hour_n_m_s, 3) })],
    ["sent", AXES.map((axis) => `${words(`app.axis.${axis}`)} ${number(sent?.[axis], 4)}`).join(", ")],
    ["proven", control.proven_axes.map((axis) => words(`app.axis.${axis}`)).join(", ") || words("views.control.noAxis")],
    check && ["signCheck", [words("views.control.signCheck", { axis: words(`app.axis.${check.axis}`), state: words(`views.control.signState.${check.state}`), done: check.legs_done, legs: check.legs, until: utc(check.until) }), check.detail && element("span", { class: "detail", lang: "en" }, ` ${check.detail}`)]],
  ].filter(Boolean);
  return element("dl", { class: "facts" }, facts.map(([key, value]) => [element("dt", {}, words(`views.control.fact.${key}`)), element("dd", {}, value)]));
}

/** Return the orders to the interlock that this person may give. */
function orders(path, may, run, said) {
  const comment = element("input", { id: "order-comment", maxLength: 1000, autocomplete: "off" });
  const axis = element("select", { id: "sign-axis" }, AXES.map((each) => element("option", { value: each }, words(`app.axis.${each}`))));
  const hours = element("input", { id: "engage-hours", type: "number", min: 0.1, max: 12, step: 0.1, value: "6" });
  const order = (verb, more = () => ({})) => () => run(() => post(`${path}/control:${verb}`, { comment: comment.value, ...more() }), said);
  const button = (key, act) => element("button", { type: "button", onclick: act }, words(`views.control.order.${key}`));
  // the answer of the first of two requests is control as it was
  const automaticWords = () => words("views.control.done.automatic");
  const automatic = () => run(() => post(`${path}/control:arm`, { comment: comment.value, release: "automatic" }), said, automaticWords);
  const engage = async () => {
    // the end is counted on the service's clock, which may be that of its data
    const act = async () => {
      const { now } = await get(`${path}/status`);
      const until = new Date(Math.floor((Date.parse(now) + 3_600_000 * Number(hours.value)) / 60_000) * 60_000).toISOString();
      return post(`${path}/control:engage`, { comment: comment.value, until });
    };
    await run(act, said);
  };
  return element("section", { class: "card orders", "aria-label": words("views.control.orders") },
    element("p", { class: "field" }, element("label", { htmlFor: "order-comment" }, words("views.control.comment")), comment),
    element("p", { class: "field" }, button("arm", order("arm")), button("disengage", order("disengage")), button("reset", order("reset"))),
    element("p", { class: "field" }, element("label", { htmlFor: "sign-axis" }, words("views.control.signAxis")), axis, button("signCheck", order("sign-check", () => ({ axis: axis.value })))),
    may("approve") && element("p", { class: "field" }, element("label", { htmlFor: "engage-hours" }, words("views.control.hours")), hours, button("engage", engage), button("automatic", automatic)),
  );
}

function prepareForm(path, run) {
  const said = element("div", { class: "said" });
  const shown = element("div");
  const reason = element("input", { id: "prepare-reason", required: true, maxLength: 1000, autocomplete: "off" });
  const start = instantInput({ id: "prepare-start" });
  const length = element("input", { id: "prepare-length", type: "number", min: 1, max: 86400, step: "any" });
  const torque = element("input", { id: "prepare-torque", type: "number", min: 0, max: 1000, step: "any" });
  const body = (isDry) => ({
    reason: reason.value,
    start: instantText(start),
    duration_s: length.value ? Number(length.value) : null,
    max_torque_n_m: torque.value ? Number(torque.value) : null,
    dry_run: isDry,
  });
  const submit = async (event) => {
    event.preventDefault();
    const isDry = event.submitter?.value !== "prepare";
    fill(shown);
    const act = async () => {
      const command = await post(`${path}/torques:prepare`, body(isDry));
      if (isDry) fill(shown, element("h3", {}, words("views.control.dryRun")), commandFacts(command));
      return command;
    };
    await run(act, said);
  };
  const field = (key, input) => element("p", { class: "field" }, element("label", { htmlFor: input.id }, words(`views.control.${key}`)), input);
  return element("form", { class: "card prepare", "aria-label": words("views.control.prepare"), onsubmit: submit },
    element("h2", {}, words("views.control.prepare")), field("reasonOfCommand", reason), field("start", start), field("length", length),
    field("greatest", torque), element("button", { type: "submit", value: "dry" }, words("views.control.lookFirst")), " ",
    element("button", { type: "submit", value: "prepare", class: "primary" }, words("views.control.prepareButton")), said, shown,
  );
}
