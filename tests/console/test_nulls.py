"""Nulls wherever an answer may have one: each field of what a view reads is null once, and the view goes on.

The views are drawn on a page without the console, from answers of the real service that the page alters itself: a load
of the whole console for each of some hundred fields would take minutes.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from service.records.operations.access import Role

SCHEMA = json.loads((Path(__file__).parents[2] / "docs/reference/openapi.json").read_text())
VIEWS = ["now", "carriers", "carriers?form=multiples", "carriers?carrier=c03&hours=1", "links", "control"]
#: these name a thing, and an answer without them is none
NAMES = ("id", "code", "carrier", "source", "kind", "method", "quantity", "name", "open_commands")

ANALYZER = {
    "id": "rack-1",
    "kind": "analyzer",
    "spacecraft_id": "yamal-202",
    "source": "sa-1",
    "state": "MEASURE",
    "detail": {"analyzer": "sa", "period_s": 60.0},
    "counters": {"rows": 5, "dropped_full": 1},
    "period_s": 5.0,
    "warnings": [{"code": "spool.disk_full", "detail": "full", "since": "2027-01-15T10:00:00Z"}],
}
WHEELS = {"wheel_momentum_n_m_s": [0.1, 0.2, 0.3]}

ALTERED = r"""async ([view, path, nullable, names]) => {
  const load = (module) => import(`/console/${module}.js`);
  const [{ createStore }, { loadWords }, page] = [await load("store"), await load("words"), document.body];
  const [name, query = ""] = view.split("?");
  await loadWords("en");
  const { show } = await load(`views/${name}`);
  const real = window.fetch;
  // nothing is looked at: no need to wait for frames
  window.requestAnimationFrame = (act) => setTimeout(act);
  const kept = new Map();
  const wrong = [];
  let altered = null;
  let waiting = 0;
  const keyOf = (url) => `${url.pathname} ${url.searchParams.getAll("method")} ${url.searchParams.get("carrier")}`;
  const answer = async (url) => {
    const key = keyOf(url);
    if (!kept.has(key)) {
      const found = await real(url.href);
      if (!found.ok) note(`${found.status} ${url.href}`);
      kept.set(key, await found.json());
    }
    const copy = structuredClone(kept.get(key));
    if (altered?.key === key) {
      const last = altered.steps.at(-1);
      altered.steps.slice(0, -1).reduce((level, step) => level[step], copy)[last] = null;
    }
    return copy;
  };
  window.fetch = async (target) => {
    waiting += 1;
    try {
      return new Response(JSON.stringify(await answer(new URL(target, location))));
    } finally {
      waiting -= 1;
    }
  };
  const field = () => (altered ? `${altered.key}: ${altered.steps.join(".")}` : "as it is");
  const note = (said) => wrong.push(`${field()}: ${said}`);
  addEventListener("error", (event) => note(event.message));
  addEventListener("unhandledrejection", (event) => note(event.reason));
  const read = (rest) => answer(new URL(`/api/v1${path}${rest}`, location));
  const session = await answer(new URL("/api/v1/session", location));
  const spacecraft = await read("");
  const frame = () => new Promise((done) => setTimeout(done));
  async function state() {
    const [robust, paper] = await Promise.all(["robust", "paper"].map((method) => read(`/attitude?method=${method}`)));
    const rests = ["/torques", "/control", "/alarms?state=open", "/status"];
    const [torque, control, alarms, status] = await Promise.all(rests.map(read));
    return { session, spacecraft, attitude: { robust, paper }, torque, control, alarms: alarms.rows, status };
  }
  async function settled() {
    for (let quiet = 0; quiet < 2; quiet = waiting ? 0 : quiet + 1) await frame();
  }
  async function draw() {
    const store = createStore();
    const link = { state: "live", since: Date.now(), problem: null };
    store.set({ ...(await state()), statusAt: performance.now(), link });
    const parameters = new URLSearchParams(query);
    const shown = show({ store, spacecraft, session, parameters, go: () => {}, rewrite: () => {} });
    page.replaceChildren(shown.node);
    await settled();
    for (const each of page.querySelectorAll("details")) each.open = true;
    const texts = [];
    const walker = document.createTreeWalker(page, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) texts.push(walker.currentNode.data);
    for (const each of page.querySelectorAll("*")) {
      texts.push(...[...each.attributes].filter(({ name }) => !name.startsWith("data-")).map(({ value }) => value));
    }
    const bad = texts.find((text) => /\bnull\b|NaN|undefined|Infinity|\[object/.test(text));
    if (bad) note(bad.slice(0, 120));
    const alert = page.querySelector(".failure");
    if (alert) note(`failed: ${alert.textContent.slice(0, 160)}`);
    shown.close();
  }
  function* stepsOf(value, before = []) {
    if (value === null || typeof value !== "object") return;
    const first = Array.isArray(value) ? value.slice(0, 1) : value;
    for (const [key, each] of Object.entries(first)) {
      const steps = [...before, key];
      const isLeaf = each === null || typeof each !== "object";
      const isName = names.includes(key) || names.includes(before.at(-1));
      if (!isName && each !== null && (isLeaf || nullable.includes(key))) yield steps;
      yield* stepsOf(each, steps);
    }
  }
  await draw();
  let count = 0;
  for (const [key, content] of [...kept]) {
    if (/session|spacecraft\/[^/]+ /.test(key)) continue;
    for (const steps of stepsOf(content)) {
      altered = { key, steps };
      await draw().catch((error) => note(error.stack));
      count += 1;
    }
  }
  return [count, wrong];
}"""


def nullable_fields(schema: Any) -> set[str]:
    """Return the names of the fields that may be null wherever the schema has them."""
    may: dict[str, list[bool]] = {}
    for each in schema["components"]["schemas"].values():
        for name, field in each.get("properties", {}).items():
            may.setdefault(name, []).append({"type": "null"} in field.get("anyOf", []))
    return {name for name, all_may in may.items() if all(all_may)}


@pytest.fixture(scope="module")
def told(ground):
    """Give the station after everything that fills the answers: operation, telemetry, link, command, torque."""
    ground.post("/operations", {"kind": "eclipse", "start": ground.epoch(60), "stop": ground.epoch(600)}, status=201)
    ground.client.post("/api/v1/links:report", json={"links": [ANALYZER]}).raise_for_status()
    key = ground.key("Anna", Role.OPERATOR)
    ground.post("/torques:prepare", {"reason": "roll is off"}, status=201, key=key)
    return ground


@pytest.mark.parametrize("view", VIEWS)
def test_a_null_in_any_field_is_no_error_and_no_word(told, new_page, view):
    # a page that is a script asks for an icon
    page = new_page(allowed=(404,))
    page.goto("/console/api.js")
    count, wrong = page.evaluate(ALTERED, [view, "/spacecraft/yamal-202", sorted(nullable_fields(SCHEMA)), list(NAMES)])
    assert count >= 40
    assert not wrong, "\n".join(wrong)
