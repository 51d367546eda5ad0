"""The module of the page on Open MCT, run by a browser on a page of another origin between a double and a service."""

import functools
import os
import re
import threading
from collections.abc import Callable, Iterator
from datetime import datetime
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import BrowserContext, Page
from release_ground import ReleaseGround, record, seed_archive
from service_process import KEY, ServiceProcess, serving_on

GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "show-angles-in-open-mct.md"
ROLL_DEG = 0.2
#: what the module uses of Open MCT, recorded: the arguments of each call are kept
RECORDED = """<!doctype html><link rel="icon" href="data:,">
<script type="module">
  import { sooPlugin } from "./soo-open-mct.js";
  const made = { types: {}, roots: [], objects: {}, composition: null, telemetry: null };
  const openmct = {
    types: { addType: (key, type) => { made.types[key] = type; } },
    objects: {
      addRoot: (identifier) => made.roots.push(identifier),
      addProvider: (namespace, provider) => { made.objects[namespace] = provider; },
    },
    composition: { addProvider: (provider) => { made.composition = provider; } },
    telemetry: { addProvider: (provider) => { made.telemetry = provider; } },
  };
  const asked = new URLSearchParams(location.search);
  sooPlugin(Object.fromEntries(asked))(openmct);
  window.made = made;
  window.came = { roll: [], pitch: [] };
  window.objectOf = async (key) => {
    const { namespace } = made.roots[0];
    return made.objects[namespace].get({ namespace, key });
  };
  document.body.textContent = "installed";
</script>
"""
SUBSCRIBE = (
    "async (axis) => { window[axis] = made.telemetry.subscribe(await objectOf(axis), (p) => came[axis].push(p)) }"
)
REQUEST = "async ([axis, options]) => made.telemetry.request(await objectOf(axis), options)"


class _Quiet(SimpleHTTPRequestHandler):
    """Files of a folder, without a log."""

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def origins(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """Serve the page and the module of the guide at two origins; the service lists the first."""
    folder = tmp_path_factory.mktemp("open-mct")
    (module,) = re.findall(r"^```javascript\n(.*?)^```$", GUIDE.read_text(), re.MULTILINE | re.DOTALL)
    (folder / "soo-open-mct.js").write_text(module)
    (folder / "index.html").write_text(RECORDED)
    handler = functools.partial(_Quiet, directory=str(folder))
    servers = [ThreadingHTTPServer(("127.0.0.1", 0), handler) for _ in range(2)]
    for server in servers:
        threading.Thread(target=server.serve_forever, daemon=True).start()
    yield [f"http://127.0.0.1:{server.server_port}" for server in servers]
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture(scope="module")
def service(origins: list[str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Give a service that lists the first origin."""
    database = tmp_path_factory.mktemp("listed") / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    with serving_on(database, {**os.environ, "SOO_ALLOWED_ORIGINS": origins[0]}) as started:
        yield started


@pytest.fixture(scope="module")
def ground(service: ServiceProcess) -> Iterator[ReleaseGround]:
    """Give a station whose spacecraft is aligned and turned about roll."""
    with service.client() as client:
        station = ReleaseGround(client, "yamal-202")
        station.align()
        station.rows(20, (0.0, ROLL_DEG, 0.0))
        yield station


@pytest.fixture
def install(
    new_context: Callable[..., BrowserContext], service: ServiceProcess, origins: list[str]
) -> Callable[..., Page]:
    """Give a function that opens the page at an origin and installs the plugin."""

    def open_(origin: int = 0, **options: str) -> Page:
        page = new_context(key=None).new_page()
        query = {"url": service.url, "key": KEY, "spacecraft": "yamal-202", **options}
        page.goto(f"{origins[origin]}/?" + "&".join(f"{name}={value}" for name, value in query.items()))
        page.get_by_text("installed").wait_for()
        return page

    return open_


def ms(epoch: str) -> float:
    """Return an epoch as Open MCT has it: milliseconds UTC."""
    return float(int(datetime.fromisoformat(epoch).timestamp() * 1000))


def request(page: Page, axis: str, ground: ReleaseGround, **options: Any) -> list[dict[str, float]]:
    """Return the points of the last hour as the provider gives them."""
    span = {"start": ms(ground.epoch(-3600)), "end": ms(ground.epoch())}
    return list(page.evaluate(REQUEST, [axis, {**span, **options}]))


def test_objects_are_a_folder_with_three_angles(install, ground) -> None:
    page = install()
    assert page.evaluate("made.roots") == [{"namespace": "soo.yamal-202", "key": "root"}]
    root = page.evaluate("objectOf('root')")
    assert (root["name"], root["type"], root["location"]) == ("yamal-202", "folder", "ROOT")
    load = "(root) => made.composition.appliesTo(root) && made.composition.load(root)"
    children = page.evaluate(f"objectOf('root').then({load})")
    assert [child["key"] for child in children] == ["yaw", "roll", "pitch"]
    roll = page.evaluate("objectOf('roll')")
    values = {value["key"]: value for value in roll["telemetry"]["values"]}
    assert (values["value"]["unit"], values["value"]["hints"]) == ("deg", {"range": 1})
    assert (values["utc"]["format"], values["utc"]["hints"]) == ("utc", {"domain": 1})
    assert roll["type"] in page.evaluate("Object.keys(made.types)")
    for supports in ("supportsRequest", "supportsSubscribe"):
        assert page.evaluate(f"objectOf('roll').then(made.telemetry.{supports})")
    assert not page.evaluate("objectOf('root').then(made.telemetry.supportsRequest)")


def test_history_is_that_of_the_service(install, ground) -> None:
    page = install()
    rows = [row for row in ground.get("/attitude/history?method=robust")["rows"] if row["roll_deg"] is not None]
    newest = {"utc": ms(rows[-1]["epoch"]), "value": rows[-1]["roll_deg"]}
    assert request(page, "roll", ground, strategy="latest", size=1) == [newest]
    points = request(page, "roll", ground, size=3600)
    assert [point["value"] for point in points] == pytest.approx([row["roll_deg"] for row in rows])
    assert points[-1]["value"] == pytest.approx(ROLL_DEG, abs=0.05)
    band = request(page, "roll", ground, strategy="minmax", size=4)
    assert [point["utc"] for point in band] == sorted(point["utc"] for point in band)
    angles = [row["roll_deg"] for row in rows]
    assert (min(p["value"] for p in band), max(p["value"] for p in band)) == (min(angles), max(angles))
    assert len(band) <= 4


def test_rows_come_as_they_are_measured_until_nobody_listens(install, ground) -> None:
    page = install()
    with page.expect_response(lambda answer: "/stream?" in answer.url) as opened:
        page.evaluate(SUBSCRIBE, "roll")
        page.evaluate(SUBSCRIBE, "pitch")
    assert opened.value.status == 200
    ground.rows(1, (0.0, ROLL_DEG, 0.0))
    page.wait_for_function("came.roll.length && came.pitch.length")
    newest = ground.get("/attitude?method=robust")
    for axis in ("roll", "pitch"):
        assert page.evaluate(f"came.{axis}") == [{"utc": ms(newest["epoch"]), "value": newest[f"{axis}_deg"]}]
    page.evaluate("roll()")
    ground.rows(1, (0.0, ROLL_DEG, 0.0))
    page.wait_for_function("came.pitch.length === 2")
    assert page.evaluate("came.roll.length") == 1
    with page.expect_event("requestfailed", lambda ended: "/stream?" in ended.url):
        page.evaluate("pitch()")


def test_a_refusal_says_why(install, ground) -> None:
    page = install(key="wrong")
    with pytest.raises(Exception, match="SOO: the key is missing"):
        request(page, "roll", ground)
    with page.expect_console_message(lambda said: "SOO: the key is missing" in said.text):
        page.evaluate(SUBSCRIBE, "roll")
    with pytest.raises(Exception, match="SOO: There is no spacecraft"):
        request(install(spacecraft="nobody"), "roll", ground)


def test_a_page_that_is_not_listed_reads_nothing(install, ground) -> None:
    page = install(origin=1)
    blocked = page.expect_console_message(lambda said: "blocked by CORS policy" in said.text)
    with blocked, pytest.raises(Exception, match="Failed to fetch"):
        request(page, "roll", ground)
