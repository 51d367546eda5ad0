/** @file The page: session, spacecraft, header, and the view that the address names. */

import { Problem, get, listeners, post, remove } from "./api.js";
import { element, fill } from "./element.js";
import { header } from "./parts/header.js";
import { failure } from "./parts/problem.js";
import { signIn } from "./parts/sign_in.js";
import { stopControl } from "./parts/stop.js";
import { EMPTY, createStore } from "./store.js";
import { follow } from "./stream.js";
import { LANGUAGES, language, loadWords, words } from "./words.js";

/** Views in the order of the navigation; `permission`: who lacks it is not offered the view. */
const VIEWS = [
  { name: "now" },
  { name: "alarms" },
  { name: "history" },
  { name: "carriers" },
  { name: "links" },
  { name: "control" },
  { name: "calibration" },
  { name: "shift" },
  { name: "archive" },
  { name: "audit", permission: "inspect" },
  { name: "keys", permission: "administer" },
  { name: "about" },
];

const store = createStore();
const top = element("div");
const main = element("main", { id: "main", tabIndex: -1 });
const stop = stopControl(store);
let stream = null;
let shown = null;
let wordsReady = Promise.resolve();
/** Counts changes of the view: one that is still loading when the next is asked for is not shown. */
let asked = 0;

/** Return view and parameters of the address: `#/history?start=…`; `?wall=1` may stand before the `#` too. */
function route() {
  const [path, query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  const parameters = new URLSearchParams([...new URLSearchParams(location.search), ...new URLSearchParams(query)]);
  return { name: offered().some((view) => view.name === path) ? path : VIEWS[0].name, parameters };
}

function offered() {
  const permissions = store.get().session?.permissions ?? [];
  return VIEWS.filter((view) => !view.permission || permissions.includes(view.permission));
}

/** Go to a view. @param {string} name @param {Object<string, string> | URLSearchParams} parameters */
function go(name, parameters = {}) {
  location.hash = addressOf(name, parameters);
}

/** Return the function by which a view writes what it shows into its address, without a step in the history. */
function rewriterOf(name, turn) {
  let known = location.hash;
  return (parameters) => {
    // another address was chosen meanwhile: it is shown next, not written over
    if (turn !== asked || location.hash !== known) return;
    history.replaceState(null, "", addressOf(name, parameters));
    known = location.hash;
  };
}

function addressOf(name, parameters) {
  const query = new URLSearchParams(parameters).toString();
  return `#/${name}${query && `?${query}`}`;
}

async function showView() {
  const { session, spacecraft } = store.get();
  if (!session) return;
  const turn = (asked += 1);
  shown?.close();
  shown = null;
  const { name, parameters } = route();
  document.documentElement.toggleAttribute("data-wall", parameters.get("wall") === "1");
  const rewrite = rewriterOf(name, turn);
  drawHeader(name);
  if (!spacecraft) {
    fill(main, element("p", { class: "notice" }, words("app.noSpacecraft")));
    return;
  }
  try {
    const view = await import(`./views/${name}.js`);
    if (turn !== asked) return;
    shown = view.show({ store, spacecraft, session, parameters, go, rewrite });
    fill(main, shown.node);
  } catch (error) {
    if (turn === asked) fill(main, failure(error instanceof Problem ? error : new Problem({ detail: String(error) })));
    throw error;
  }
}

function drawHeader(current) {
  const { session, spacecraft } = store.get();
  document.title = `${words(`views.${current}.title`)} – ${spacecraft?.id ?? words("app.title")}`;
  const key = [language(), session.name, spacecraft?.id].join(" ");
  stop.draw();
  // the same header stays, and with it the focus of the keyboard
  if (top.dataset.shown !== key) {
    top.dataset.shown = key;
    fill(top, header({ store, stop, views: offered(), chooseSpacecraft, changeLanguage, changeTheme, signOut }));
  }
  for (const link of top.querySelectorAll("nav a")) {
    if (link.getAttribute("href") === `#/${current}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

/** Choose a spacecraft; without one of this name, the first. */
function chooseSpacecraft(id) {
  const { fleet, spacecraft } = store.get();
  const chosen = fleet.find((each) => each.id === id) ?? fleet[0] ?? null;
  if (stream && chosen?.id === spacecraft?.id) return;
  stream?.close();
  store.set({ ...EMPTY, session: store.get().session, fleet, offsetMs: store.get().offsetMs, spacecraft: chosen });
  if (chosen) localStorage.setItem("soo.spacecraft", chosen.id);
  stream = chosen && follow(store, chosen.id);
  showView();
}

async function begin() {
  try {
    const [session, fleet] = await Promise.all([get("/session"), get("/spacecraft"), wordsReady]);
    store.set({ session, fleet: fleet.rows });
    fill(document.body, element("a", { class: "skip", href: "#main", onclick: skip }, words("app.skip")), top, main);
    chooseSpacecraft(localStorage.getItem("soo.spacecraft"));
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    await wordsReady;
    end(error.status === 401 ? null : error);
  }
}

function skip(event) {
  event.preventDefault();
  main.focus();
}

/** Show the form for a key; why, where somebody was signed in. */
function end(problem) {
  asked += 1;
  stream?.close();
  shown?.close();
  [stream, shown] = [null, null];
  delete top.dataset.shown;
  store.set({ ...EMPTY });
  stop.draw();
  document.title = words("app.title");
  const open = async (key) => {
    await post("/session", { key });
    await begin();
  };
  fill(document.body, signIn({ open, problem, changeLanguage, changeTheme }));
}

async function signOut() {
  try {
    await remove("/session");
    end(null);
  } catch (error) {
    end(error instanceof Problem ? error : new Problem({ detail: String(error) }));
  }
}

async function changeLanguage(wanted) {
  localStorage.setItem("soo.language", wanted);
  await loadWords(wanted);
  if (store.get().session) showView();
  else end(null);
}

function changeTheme(theme) {
  localStorage.setItem("soo.theme", theme);
  document.documentElement.dataset.theme = theme;
}

function preferred(name, allowed, otherwise) {
  const kept = localStorage.getItem(name);
  return allowed.includes(kept) ? kept : otherwise;
}

listeners.unauthorized = () => {
  if (store.get().session) end(new Problem({ code: "key.ended" }));
};
listeners.clock = (offsetMs) => {
  // the header of the answer has whole seconds: smaller changes are its rounding
  if (Math.abs(offsetMs - store.get().offsetMs) > 1000) store.set({ offsetMs });
};
addEventListener("hashchange", showView);
changeTheme(preferred("soo.theme", ["dark", "light"], matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));
wordsReady = loadWords(preferred("soo.language", LANGUAGES, LANGUAGES.find((each) => navigator.language.startsWith(each)) ?? LANGUAGES[0]));
await begin();
