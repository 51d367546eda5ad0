"""Pages for operators: each step of analyzers, links, torques and shifts runs as it is written."""

import csv
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import yaml
from fault_table import markdown_table
from page_blocks import CRAFT, run_blocks
from pydantic import BaseModel
from release_ground import ReleaseGround, record, seed_archive

from analyzer_sim.__main__ import main
from docs.reference_pages import acquisition_diagram, acquisition_page
from service.api.monitoring.metrics import FAMILIES, MAX_CARRIERS, MAX_LINKS, MAX_SOURCES, MAX_SPACECRAFT
from service.api.schemas.catalogue import CarrierDocument
from service.api.views.present import SILENT
from service.client.service_client import ServiceClient
from service.frontend.acquisition.states import (
    ACTIONS,
    MEANINGS,
    TRANSITIONS,
    AcquisitionEvent,
    AcquisitionState,
)
from service.frontend.drivers.dialects import DIALECTS, SINGLE, Dialect
from service.frontend.link_report import RUNNING, SERVICE_AWAY
from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.tasks.task_plan import load_station, plan_task
from service.records.operations.work import STOPPED

AXES = ("yaw", "roll", "pitch")
NAMES = tuple(f"{axis}_deg" for axis in AXES)
HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
#: what each block of the first shift prints
SHIFT = (
    ("bash", "1 warning roll angle is 0.3"),
    ("console", '"spacecraft_id": "yamal-202"'),
    ("bash", "ACQUIRED ['unannounced_motion']"),
    ("bash", "event: status"),
    ("bash", '"state":"acknowledged"'),
    ("bash", '"kind":"station_keeping"'),
    ("bash", "unannounced_motion - roll or pitch moves"),
    ("bash", '"trips":["stop"]'),
    ("bash", '"text":"Roll alarm 1 acknowledged'),
)
#: what each block of the page for an own satellite prints
OWN = (
    ("bash", "spacecraft yamal-202 is stored"),
    ("bash", "plan 1 holds 16 carriers"),
    ("bash", "ephemeris 1 is in force until"),
    ("bash", "4890 accepted"),
    ("bash", "yaw sign proven warnings ['paper method: only 15"),
    ("bash", '"status":"ACQUIRED"'),
    ("python", "1 True"),
)


@pytest.fixture
def archive(tmp_path: Path) -> None:
    """A spacecraft that is calibrated, laid down before the service starts."""
    seed_archive(f"sqlite:///{tmp_path / 'archive.db'}", record("yamal-202"))


@pytest.mark.slow
@pytest.mark.system
def test_first_shift(archive: None, service: Any, tmp_path: Path) -> None:
    headers = {"Authorization": f"Bearer {service.environment['SOO_KEY']}"}
    with httpx.Client(base_url=service.url, headers=headers, timeout=120, trust_env=False) as client:
        ground = ReleaseGround(client, "yamal-202")
        ground.align()
        ground.rows(15, (0.0, 0.03, 0.0))
        ground.rows(15, (0.0, 0.34, 0.0))
        run_blocks(HOW_TO / "first-shift.md", SHIFT, service.environment, tmp_path)
        handover = client.get(f"{ground.base}/handover").json()
    assert handover["control"]["state"] == "TRIPPED"
    assert [note["tags"] for note in handover["notes"]] == [[], ["control"]]


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.system
def test_own_satellite(service: Any, tmp_path: Path) -> None:
    main(["export", "--scenario", "nominal", "--operation-days", "0.05", "--out", str(tmp_path / "world.npz")])
    with np.load(tmp_path / "world.npz") as world:
        lay_files(dict(world), tmp_path)
    run_blocks(HOW_TO / "your-own-satellite.md", OWN, service.environment, tmp_path)


def lay_files(world: dict[str, Any], folder: Path) -> None:
    """Write the files that the page takes as given: carriers, ephemeris, levels, sensor readings."""
    for line in json.loads(str(world["catalogue_json"])):
        if line["kind"] in ("carriers", "ephemeris"):
            (folder / f"{line['kind']}.json").write_text(json.dumps(line["body"]))
    with (folder / "levels.csv").open("w", newline="") as file:
        table = csv.writer(file, delimiter=";")
        table.writerow(["Time", *world["carrier_id"]])
        table.writerows(
            [without_zone(epoch), *("" if np.isnan(level) else f"{level:.3f}".replace(".", ",") for level in levels)]
            for epoch, levels in zip(world["epoch_us"], world["power_dbm"], strict=True)
        )
    angles = zip(*(world[f"reference_{axis}_deg"].tolist() for axis in AXES), strict=True)
    with (folder / "star-tracker.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["Time", *NAMES])
        table.writerows(
            [without_zone(epoch), *row] for epoch, row in zip(world["reference_epoch_us"], angles, strict=True)
        )


def without_zone(epoch_us: Any) -> str:
    """Return an epoch as programs write that know one zone only."""
    return str(np.datetime64(int(epoch_us), "us")).replace("T", " ")


def test_example_of_a_carrier_is_one() -> None:
    blocks = re.findall(
        r"^```json\n(.*?)^```", (HOW_TO / "your-own-satellite.md").read_text(), re.DOTALL | re.MULTILINE
    )
    assert CarrierDocument.model_validate_json(blocks[0]).id == "c00"


ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/how-to/connect-an-analyzer.md").read_text()
#: heading of each dialect's section
HEADINGS = {
    "rs": "Rohde & Schwarz",
    "keysight": "Keysight",
    "siglent": "Siglent",
    "anritsu": "Anritsu",
    "generic": "Any other",
}


def sent(dialect: Dialect) -> list[str]:
    """Return the settings of a session, alternatives included, without repetition."""
    alternatives = [word for words in dialect.detectors for word in words]
    words = [SINGLE, *dialect.method, *alternatives, *dialect.formats[0].words]
    return list(dict.fromkeys(f"{word.header} {word.value}" for word in words))


@pytest.mark.parametrize("dialect", DIALECTS, ids=[dialect.name for dialect in DIALECTS])
def test_settings_of_a_section_are_those_sent(dialect: Dialect) -> None:
    section = PAGE.split(f"### {HEADINGS[dialect.name]}\n")[1]
    block = re.search(r"```text\n(.*?)```", section, re.DOTALL)
    assert block is not None
    assert block.group(1).splitlines() == sent(dialect)


def test_every_dialect_has_a_section() -> None:
    assert set(HEADINGS) == {dialect.name for dialect in DIALECTS}


def test_table_of_faults_is_the_one_that_the_test_causes() -> None:
    assert markdown_table() in (ROOT / "docs/evidence/analyzer-faults.md").read_text()


def test_example_of_a_station_is_one(tmp_path: Path) -> None:
    block = re.findall(r"^```json\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[1]
    (tmp_path / "station.json").write_text(block)
    assert len(load_station(tmp_path / "station.json")) == len(json.loads(block)) == 2


def test_resources_are_names_that_can_be_opened() -> None:
    names = set(re.findall(r"TCPIP::[^\"`]+", PAGE))
    assert len(names) >= 3
    assert all(re.fullmatch(r"TCPIP::[\d.]+::(\d+::SOCKET|hislip0::INSTR)", name) for name in names)


def example() -> bytes:
    """Return the task of the page, its first JSON block."""
    block, *_ = re.findall(r"^```json\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return bytes(block, "utf-8")


def test_example_is_a_task_without_faults() -> None:
    task, _ = parse_task(example())
    plan = plan_task(task)
    assert plan.findings == ()
    # more than the figure of a sweep would be a task too weak to show; below it nothing is claimed
    assert all(0.0 < sigma_db < 0.2 for sigma_db in plan.sigma_db.values()), plan.sigma_db


def names_of(model: type[BaseModel]) -> set[str]:
    """Return the names of all fields of a model and of the models inside."""
    names = set(model.model_fields)
    for field in model.model_fields.values():
        for part in parts_of(field.annotation):
            names |= names_of(part)
    return names


def parts_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [part for inner in getattr(annotation, "__args__", ()) for part in parts_of(inner)]


def test_table_explains_fields_that_exist() -> None:
    rows = re.findall(r"^\| (`[a-z].*?) \| [^|]* \| [^|]* \|$", PAGE, re.MULTILINE)
    named = {name for row in rows for path in re.findall(r"`([^`]+)`", row) for name in re.split(r"\W+", path) if name}
    assert len(named) > 25, "the table was not found"
    assert named - names_of(MeasurementTask) == set()


TORQUE_PAGE = ROOT / "docs" / "how-to" / "release-a-torque.md"
#: language of each block and what it must print
PRINTED = (
    ("bash", '"state":"INHIBITED"'),
    ("bash", '"state":"ARMED"'),
    ("python", "envelope ok\n"),
    ("bash", '"state":"PREPARED"'),
    ("python", "Anna wants: roll is off\nRELEASED\n"),
    ("bash", '"state":"SENT"'),
    ("python", "EXECUTED "),
    ("bash", '"trips":["stop"]'),
    ("bash", '"state":"INHIBITED"'),
)


@pytest.mark.system
@pytest.mark.slow
def test_the_blocks_run_as_they_stand(archive: None, service: Any, tmp_path: Path) -> None:
    headers = {"Authorization": f"Bearer {service.environment['SOO_KEY']}"}
    with httpx.Client(base_url=service.url, headers=headers, timeout=120, trust_env=False) as client:
        ground = ReleaseGround(client, "yamal-202")
        ground.align()
        ground.rows(15, (0.0, 0.03, 0.0))
        keys = {"ANNA_KEY": ground.key("Anna", "operator"), "BORIS_KEY": ground.key("Boris", "approver")}
        run_blocks(TORQUE_PAGE, PRINTED, {**service.environment, **keys}, tmp_path)
        notes = client.get("/api/v1/notes", params={"spacecraft_id": "yamal-202"}).json()["rows"]
    uplink = json.loads((tmp_path / "uplink.json").read_text())
    assert (uplink["counter"], uplink["simulated"], uplink["form"]) == (1, True, "torques")
    assert [note["text"] for note in notes] == [
        "arm: roll drifts, correction before the night",
        "stop: unexpected motion",
    ]


def test_codes_of_the_table_are_those_of_the_reference() -> None:
    codes = [
        line.split("`")[1]
        for line in TORQUE_PAGE.read_text().partition("| code | do |")[2].splitlines()
        if "| `" in line
    ]
    reference = (ROOT / "docs" / "reference" / "errors.md").read_text()
    assert len(codes) >= 10
    assert [code for code in codes if f"| `{code}` |" not in reference] == []


DOCS = Path(__file__).resolve().parents[2] / "docs"
LINK_PAGE = DOCS / "how-to" / "watch-the-links.md"
STATES = DOCS / "reference" / "acquisition-states.md"
#: told in place of the state of an acquisition that hangs
STUCK = "STUCK"
CARRIER = {"id": "b0", "band": "Ku", "transponder": "Ku1", "downlink_hz": 11.2e9, "bandwidth_hz": 1e3, "kind": "beacon"}
EPOCH = "2026-11-21T03:00:00.000000Z"
TRACE = {
    "epoch": EPOCH,
    "sweep": "ku",
    "start_hz": 954e6,
    "step_hz": 15e3,
    "rbw_hz": 30e3,
    "enbw_hz": 31e3,
    "sweep_time_s": 2.0,
    "power_dbm": [-90.0, -60.5, None],
}
REPORT = {
    "id": "yamal-202.sa-1",
    "kind": "analyzer",
    "spacecraft_id": "yamal-202",
    "source": "sa-1",
    "state": "MEASURE",
}


def test_the_page_names_every_state_and_no_other() -> None:
    table = LINK_PAGE.read_text().partition("## What each state means")[2].partition("`reported_state`")[0]
    named = re.findall(r"^\| `([A-Z_]+)` \| \S", table, re.MULTILINE)
    assert len(named) == len(set(named))
    assert set(named) == {state.name for state in AcquisitionState} | {STUCK, RUNNING, SERVICE_AWAY, SILENT, STOPPED}


@pytest.mark.system
@pytest.mark.slow
def test_the_blocks_on_links_run_as_they_stand(service: Any, tmp_path: Path) -> None:
    blocks = re.findall(r"^```bash\n(.*?)^```", LINK_PAGE.read_text(), re.DOTALL | re.MULTILINE)
    with ServiceClient(service.url, service.environment["SOO_KEY"], retries=6, timeout_s=120) as client:
        client.create_spacecraft(CRAFT)
        plan_id = client.put_carriers("yamal-202", [CARRIER])["plan_id"]
        row = {"epoch": EPOCH, "power_dbm": [-42.0], "flags": [16], "sigma_db": [0.05]}
        client.post_measurements("yamal-202", plan_id, [row], source="sa-1", first_seq=1)
        client.post_traces("yamal-202", "sa-1", [TRACE])
        assert client.report_links([REPORT]) == [{"id": "yamal-202.sa-1", "enabled": True, "reset": 0}]
        printed = [run(block, service.environment, tmp_path) for block in blocks]
        assert '"state":"MEASURE"' in printed[0]
        assert ['"enabled":false' in text for text in printed[:4]] == [False, True, False, False]
        assert '"NO_CARRIER"' in printed[4]
        assert printed[5].splitlines() == [
            "frequency_hz,power_dbm",
            "954000000.0,-90.0",
            "954015000.0,-60.5",
            "954030000.0,",
        ]
        assert client.report_links([REPORT]) == [{"id": "yamal-202.sa-1", "enabled": True, "reset": 1}]


def run(block: str, environment: dict[str, str], folder: Path) -> str:
    """Run a block and return what it printed."""
    script = f"set -euo pipefail\n{block}"
    done = subprocess.run(
        ["bash", "-c", script], env=environment, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, f"{block}\n{done.stderr}"
    return done.stdout


def test_page_of_states_is_the_table() -> None:
    assert STATES.read_text() == acquisition_page()


def test_page_of_states_names_every_state_and_event_and_draws_every_change() -> None:
    page = acquisition_page()
    assert set(ACTIONS) == set(AcquisitionState)
    assert set(MEANINGS) == set(AcquisitionEvent)
    assert all(f"| {state.name} |" in page for state in AcquisitionState)
    for state, row in TRANSITIONS.items():
        for event, target in row.items():
            if target is not state:
                (line,) = [
                    each for each in acquisition_diagram().splitlines() if f"{state.name} --> {target.name}:" in each
                ]
                assert event.name in line


SERVICE_PAGE = (ROOT / "docs" / "how-to" / "watch-the-service.md").read_text()
DASHBOARD = ROOT / "deploy" / "grafana" / "soo.json"
RULES = ROOT / "deploy" / "prometheus" / "soo-alerts.yml"
_NAME = re.compile(r"\bsoo_[a-z_]+\b")


def metrics_of(text: str) -> set[str]:
    """Return the metrics that expressions name; parts of a histogram count as the whole."""
    found = set(_NAME.findall(text))
    return {name if name in FAMILIES else re.sub(r"_(bucket|count|sum)$", "", name) for name in found}


def expressions() -> list[str]:
    """Return the expressions of the dashboard and of the rules."""
    panels = json.loads(DASHBOARD.read_text())["panels"]
    shown = [target["expr"] for panel in panels for target in panel["targets"]]
    ruled = re.findall(r"^ +expr: (.+)$", RULES.read_text(), re.MULTILINE)
    assert len(ruled) == RULES.read_text().count("- alert:") >= 12
    return shown + ruled


def test_dashboard_and_rules_name_only_metrics_that_exist() -> None:
    for expression in expressions():
        assert metrics_of(expression), expression
        assert metrics_of(expression) <= FAMILIES.keys(), expression


def test_every_metric_is_on_the_dashboard() -> None:
    panels = json.loads(DASHBOARD.read_text())["panels"]
    shown = metrics_of(" ".join(target["expr"] for panel in panels for target in panel["targets"]))
    assert FAMILIES.keys() - shown == set()


def test_labels_in_expressions_are_those_of_the_metric() -> None:
    for expression in expressions():
        for name, selector in re.findall(r"\b(soo_[a-z_]+)\{([^}]*)\}", expression):
            labels = set(re.findall(r"(\w+)=~?\"", selector))
            assert labels <= set(FAMILIES[re.sub(r"_bucket$", "", name)].labels), expression


def test_grafana_finds_the_dashboard_and_the_source_that_it_asks_for() -> None:
    provisioning = DASHBOARD.parent / "provisioning"
    (source,) = yaml.safe_load((provisioning / "datasources" / "soo.yml").read_text())["datasources"]
    (provider,) = yaml.safe_load((provisioning / "dashboards" / "soo.yml").read_text())["providers"]
    dashboard = json.loads(DASHBOARD.read_text())
    (chooser,) = [each for each in dashboard["templating"]["list"] if each["type"] == "datasource"]
    used = {panel["datasource"]["uid"] for panel in dashboard["panels"]}
    assert (source["type"], used) == (chooser["query"], {f"${{{chooser['name']}}}"})
    assert (source["isDefault"], source["url"], provider["type"]) == (True, "$SOO_PROMETHEUS_URL", "file")
    compose = yaml.safe_load((ROOT / "deploy" / "fleet" / "docker-compose.yml").read_text())["services"]["grafana"]
    mounts = dict(volume.split(":")[:2] for volume in compose["volumes"])
    assert mounts["../grafana/soo.json"] == f"{provider['options']['path']}/{DASHBOARD.name}"
    for kind in ("datasources", "dashboards"):
        path = f"provisioning/{kind}/soo.yml"
        assert mounts[f"../grafana/{path}"] == f"/etc/grafana/{path}"
    assert compose["environment"].keys() == {"SOO_PROMETHEUS_URL", "GF_SECURITY_ADMIN_PASSWORD__FILE"}
    for word in ("deploy/grafana/provisioning/", provider["options"]["path"], "SOO_PROMETHEUS_URL"):
        assert word in SERVICE_PAGE


def test_rules_say_what_to_do() -> None:
    text = RULES.read_text()
    for word in ("summary:", "action:", "severity:", "for:"):
        assert text.count(word) == text.count("- alert:"), word


def test_page_lists_every_metric_as_it_is() -> None:
    text = re.sub(r"\n  ", " ", SERVICE_PAGE)
    rows = re.findall(r"^\* `(soo_\w+)`, (\w+)(?: by ([^:]+))?: (.+)$", text, re.MULTILINE)
    reported = {name: (kind, tuple(re.findall(r"`(\w+)`", labels)), meaning) for name, kind, labels, meaning in rows}
    assert reported == {name: (family.kind, family.labels, family.help) for name, family in FAMILIES.items()}
    assert f"{MAX_SPACECRAFT}, {MAX_SOURCES}, {MAX_CARRIERS} and {MAX_LINKS} are told" in SERVICE_PAGE
