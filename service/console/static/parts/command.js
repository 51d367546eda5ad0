/** @file One command: who wants what, its checks and pulses, and what may be done with it by whom. */

import { AXES, address, get, post } from "../api.js";
import { element } from "../element.js";
import { instantInput, instantText } from "../lists/instant_input.js";
import { meaning, number, utc, words } from "../words.js";
import { pulsePlots } from "./steps.js";
import { symbol } from "./symbol.js";

/** Return what a command is. @param {any} command */
export function commandFacts(command) {
  const { predicted, schedule_check: check } = command;
  const impulse = axes(command.gross_impulse_n_m_s, 4, "unit.n_m_s");
  const facts = [
    ["reason", element("bdi", {}, command.reason)],
    ["purpose", words(`views.control.purpose.${command.purpose}`)],
    ["preparedBy", [element("bdi", {}, command.prepared_by), `, ${utc(command.prepared_at)}`]],
    command.confirmed_by && ["confirmedBy", [element("bdi", {}, command.confirmed_by), `, ${utc(command.released_at)}`]],
    command.comment && ["comment", element("bdi", {}, command.comment)],
    command.reported_by && ["reportedBy", [element("bdi", {}, command.reported_by), `, ${utc(command.reported_at)}`]],
    ["span", `${utc(command.start)} – ${utc(command.stop, "time")} UTC`],
    !command.dry_run && command.state === "PREPARED" && ["expires", utc(command.expires_at)],
    ["estimate", utc(command.attitude_epoch)],
    ["impulse", impulse],
    ["change", axes(predicted.angle_change_deg, 4, "unit.deg")],
    ["peak", axes(predicted.peak_angle_deg, 4, "unit.deg")],
    ["rate", axes(predicted.rate_change_deg_s, 6, "unit.deg_s")],
    check && ["flexible", words("views.control.flexible", { verdict: words(`views.control.schedule.${check.verdict}`), peak: number(check.peak_deg, 4) })],
    ["digest", element("code", { class: "digest" }, command.digest)],
  ].filter(Boolean);
  return [
    element("dl", { class: "facts" }, facts.map(([name, value]) => [element("dt", {}, words(`views.control.fact.${name}`)), element("dd", {}, value)])),
    checks(command.checks),
    pulsePlots(command),
  ];
}

function axes(values, digits, unit) {
  const parts = AXES.map((axis) => `${words(`app.axis.${axis}`)} ${number(values[axis], digits)}`);
  return `${parts.join(", ")} ${words(`views.control.${unit}`)}`;
}

function checks(all) {
  const rows = all.map(({ name, ok, detail }) =>
    element("li", {}, symbol(ok ? "normal" : "critical"), " ", words(`views.control.check.${name.replace(/ /g, "_")}`), ": ", words(ok ? "views.control.ok" : "views.control.notOk"), detail && element("span", { class: "detail", lang: "en" }, ` ${detail}`)),
  );
  return element("ul", { class: "checks", "aria-label": words("views.control.checks") }, rows);
}

/**
 * Return a prepared command that waits for another person, with the forms of those who may do something.
 * @param {any} command @param {any} context
 * @param {(act: () => Promise<any>, said: any) => Promise<boolean>} run Shows what comes of an order at `said`.
 */
export function waitingCommand(command, { spacecraft, session }, run) {
  const base = `/spacecraft/${spacecraft.id}/torques/${command.id}`;
  const said = element("div", { class: "said" });
  const comment = element("input", { id: "confirm-comment", maxLength: 1000, autocomplete: "off" });
  const key = element("input", { id: "second-key", type: "password", autocomplete: "off", maxLength: 256, required: true });
  const body = () => ({ digest: command.digest, comment: comment.value });
  const confirmByKey = async (event) => {
    event.preventDefault();
    const given = key.value.trim();
    // forgotten here, whatever the answer is
    key.value = "";
    await run(() => post(`${base}:confirm`, body(), { key: given }), said);
  };
  const isSecond = session.permissions.includes("approve") && session.name !== command.prepared_by;
  const mayCancel = session.permissions.includes("operate");
  return element("section",
    { class: "card waiting", "data-command": command.id, "aria-label": words("views.control.waiting", { id: command.id }) },
    element("h2", {}, words("views.control.waiting", { id: command.id }), " ", command.simulated && element("strong", { class: "simulated" }, words("app.simulated"))),
    commandFacts(command),
    mayCancel && element("p", { class: "field" }, element("label", { htmlFor: "confirm-comment" }, words("views.control.comment")), comment),
    isSecond && element("p", {}, element("button", { type: "button", class: "primary", onclick: () => run(() => post(`${base}:confirm`, body()), said) }, words("views.control.confirmAs")), " ", element("bdi", {}, session.name)),
    mayCancel &&
      element("form", { class: "field", onsubmit: confirmByKey },
        element("label", { htmlFor: "second-key" }, words("views.control.secondKey")), key,
        element("button", { type: "submit" }, words("views.control.confirmByKey")),
      ),
    mayCancel && element("p", { class: "detail" }, words("views.control.secondKeyExplained")),
    mayCancel && element("button", { type: "button", onclick: () => run(() => post(`${base}:cancel`, { comment: comment.value }), said) }, words("views.control.cancel")),
    said,
  );
}

/**
 * Return a released command whose report is owed.
 * @param {any} command @param {any} context @param {(act: () => Promise<any>, said: any) => Promise<boolean>} run
 */
export function owedCommand(command, { spacecraft, session }, run) {
  const path = `/spacecraft/${spacecraft.id}/torques/${command.id}`;
  const said = element("div", { class: "said" });
  const [from, until] = ["from", "until"].map((name) => instantInput({ id: `executed-${name}`, placeholder: utc(name === "from" ? command.start : command.stop) }));
  const report = (word) => () =>
    run(() => post(`${path}:${word}`, word === "sent" ? {} : { executed_from: instantText(from), executed_until: instantText(until) }), said);
  const button = (word) => element("button", { type: "button", onclick: report(word) }, words(`views.control.report.${word}`));
  return element("section",
    { class: "card owed", "data-command": command.id, "aria-label": words("views.control.owed", { id: command.id }) },
    element("h2", {}, words("views.control.owed", { id: command.id }), " ", meaning("commands", command.state)),
    element("p", {}, element("a", { href: address(`${path}/uplink`), download: `uplink-${spacecraft.id}-${command.id}.json` }, words("views.control.uplink"))),
    session.permissions.includes("operate") && [
      element("div", { class: "field" }, command.state === "RELEASED" && button("sent"), button("executed"), button("failed"),
        element("label", { htmlFor: "executed-from" }, words("views.control.executedFrom")), from,
        element("label", { htmlFor: "executed-until" }, words("views.control.executedUntil")), until,
      ),
      element("p", { class: "detail" }, words("views.control.reportExplained")),
    ],
    said, commandFacts(command),
  );
}

/** Return the history of commands, newest first; a row opens its facts. @param {any[]} commands @param {any} spacecraft */
export function commandHistory(commands, spacecraft) {
  const rows = [...commands].reverse().map((command) =>
    element("details", { "data-command": command.id, ontoggle: (event) => open(event.currentTarget, command, spacecraft) },
      element("summary", {}, `${command.id} · ${utc(command.prepared_at)} · ${meaning("commands", command.state)} · `,
        element("bdi", {}, command.prepared_by), command.confirmed_by && [" + ", element("bdi", {}, command.confirmed_by)], " · ",
        element("bdi", {}, command.reason),
      ),
    ),
  );
  return rows.length ? rows : element("p", { class: "detail" }, words("views.control.noCommands"));
}

async function open(details, command, spacecraft) {
  if (!details.open || details.childElementCount > 1) return;
  // a list has no predicted angles
  const whole = await get(`/spacecraft/${spacecraft.id}/torques/${command.id}`).catch(() => command);
  if (details.childElementCount === 1) details.append(...commandFacts(whole).flat().filter(Boolean));
}
