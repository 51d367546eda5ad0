/** @file The header of every view: which spacecraft, what time, is it live, what alarms, who I am, where to go. */

import { element, every, fill, setText } from "../element.js";
import { duration, utc, words } from "../words.js";
import { alarmSummary } from "./alarm_summary.js";
import { languageChooser, themeChooser } from "./choosers.js";
import { problemText } from "./problem.js";
import { symbol } from "./symbol.js";

/** A workstation that is further off hears of it. */
const OFFSET_SHOWN_MS = 2000;

/**
 * @param {{store: any, stop: {button: any, panel: any}, views: {name: string}[], chooseSpacecraft: (id: string) => void, changeLanguage: (language: string) => void, changeTheme: (theme: string) => void, signOut: () => void}} parts
 */
export function header({ store, stop, views, chooseSpacecraft, changeLanguage, changeTheme, signOut }) {
  const { session, fleet, spacecraft } = store.get();
  const options = fleet.map((each) => element("option", { value: each.id, selected: each.id === spacecraft?.id }, each.name ? `${each.id} · ${each.name}` : each.id));
  const chooser = element("select", { "aria-label": words("app.spacecraft"), onchange: () => chooseSpacecraft(chooser.value) }, options);
  const person = element("span", { class: "person", title: words(`app.role.${session.role}`) }, session.name);
  const bar = element("div", { class: "bar" }, chooser,
    spacecraft?.simulated && element("strong", { class: "simulated" }, words("app.simulated")), clock(store), linkState(store),
    alarmSummary(store), element("span", { class: "space" }), stop.button,
  );
  const account = element("div", { class: "account" }, person,
    element("button", { type: "button", onclick: signOut }, words("app.signOut")), languageChooser(changeLanguage),
    themeChooser(changeTheme),
  );
  const links = views.map(({ name }) =>
    element("li", {}, element("a", { href: `#/${name}` }, words(`views.${name}.title`))),
  );
  const navigation = element("nav", { "aria-label": words("app.views") }, element("ul", {}, links));
  return element("header", {}, bar, stop.panel, element("div", { class: "views" }, navigation, account));
}

/** Return the service's present; it runs on by itself only under the clock of the system. */
export function presentOf({ status, statusAt }) {
  if (!status?.now) return NaN;
  return new Date(status.now).getTime() + (status.clock === "system" ? performance.now() - statusAt : 0);
}

function clock(store) {
  const time = element("time", { class: "utc" });
  const offset = element("span", { class: "offset" });
  const draw = () => {
    const { status, offsetMs } = store.get();
    setText(time, `${utc(presentOf(store.get()))} UTC`);
    const isOff = Math.abs(offsetMs) >= OFFSET_SHOWN_MS;
    const by = isOff && words(offsetMs > 0 ? "app.clock.behind" : "app.clock.ahead", { time: duration(offsetMs / 1000) });
    setText(offset, [status?.clock === "data" && words("app.clock.data"), by].filter(Boolean).join("; "));
  };
  return every(draw, element("span", { class: "clock" }, time, offset));
}

function linkState(store) {
  const node = element("span", { class: "link", role: "status" });
  let former = "";
  const draw = () => {
    const { state, since, problem } = store.get().link;
    const key = `${state} ${since} ${problem?.code}`;
    if (key === former) return;
    former = key;
    const level = { live: "normal", cut: "critical", opening: "off" }[state];
    // the instant by the service's clock, as every other on the page
    const at = utc(since + store.get().offsetMs, "time");
    node.title = problem ? problemText(problem) : "";
    node.classList.toggle("abnormal", state === "cut");
    fill(node, symbol(level), words(`app.link.${state}`, { at }));
  };
  return every(draw, node);
}
