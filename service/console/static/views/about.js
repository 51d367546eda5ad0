/** @file About: which version answers, by which clock, with which settings, and made of what. */

import { get } from "../api.js";
import { element, fill } from "../element.js";
import { failure } from "../parts/problem.js";
import { duration, utc, words } from "../words.js";

export const name = "about";

/** @param {{store: any}} context */
export function show({ store }) {
  const ending = new AbortController();
  const body = element("div", {}, element("p", { class: "notice" }, words("views.about.loading")));
  load();
  return { node: element("section", { class: "about", "aria-label": words("views.about.title") }, body), close: () => ending.abort() };

  async function load() {
    try {
      const about = await get("/about", {}, { signal: ending.signal });
      fill(body, contents(about, store.get().offsetMs));
    } catch (error) {
      if (!ending.signal.aborted) fill(body, failure(error), element("button", { type: "button", onclick: load }, words("app.list.again")));
    }
  }
}

function contents(about, offsetMs) {
  const { settings, shipped, clock } = about;
  const set = settings.filter(({ source }) => source !== "default");
  return [
    element("h1", {}, words("views.about.heading", { version: about.version })),
    element("dl", {}, fact("version", about.version), fact("python", about.python), fact("now", `${utc(clock.now)} UTC`),
      fact("clock", words(`views.about.clocks.${clock.kind}`)),
      fact("offset", words(Math.abs(offsetMs) < 2000 ? "views.about.equal" : offsetMs > 0 ? "views.about.behind" : "views.about.ahead", { time: duration(offsetMs / 1000) })),
    ),
    element("h2", {}, words("views.about.settings")),
    element("p", { class: "detail" }, words("views.about.settingsNote", { count: set.length })),
    set.length > 0 && settingsTable("set", set),
    element("details", {}, element("summary", {}, words("views.about.others", { count: settings.length - set.length })), settingsTable("settings", settings.filter((each) => !set.includes(each)))),
    element("h2", {}, words("views.about.licences")),
    table("licences", ["name", "version", "licence"], shipped.map((each) => ({ class: "", cells: [each.name, each.version, each.licence ?? words("views.about.noLicence")] }))),
  ];
}

function settingsTable(label, settings) {
  const cells = (each) => [each.name, each.value, each.unit ?? "", each.default, words(`views.about.sources.${each.source}`), each.meaning];
  return table(
    label,
    ["name", "value", "unit", "default", "source", "meaning"],
    settings.map((each) => ({ class: each.value === each.default ? "" : "changed", cells: cells(each) })),
  );
}

const fact = (key, value) => [element("dt", {}, words(`views.about.fact.${key}`)), element("dd", {}, value)];

function table(label, columns, rows) {
  const heads = columns.map((each) => element("th", { scope: "col" }, words(`views.about.column.${each}`)));
  const lines = rows.map((row) =>
    element("tr", { class: row.class }, row.cells.map((text, k) => (k === 0 ? element("th", { scope: "row" }, text) : element("td", { lang: columns[k] === "meaning" ? "en" : null }, element("bdi", {}, text))))),
  );
  return element("div", { class: "scroll", tabIndex: 0, role: "region", "aria-label": words(`views.about.${label}`) },
    element("table", {}, element("thead", {}, element("tr", {}, heads)), element("tbody", {}, lines)),
  );
}
