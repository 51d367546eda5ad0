"""Reference pages say what the code does: alarms, commands, levels, interlock, packages, ports, settings."""

import argparse
import doctest
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import typer
from flight_geometry import turned_direction
from pydantic import SecretStr
from typer.testing import CliRunner

from analyzer_sim.__main__ import build_parser
from analyzer_sim.serving import FAULT_NAMES
from docs import reference_pages
from docs.client_types import TYPES, client_types
from service.cli.app import app
from service.cli.reference import settings_markdown
from service.client import documents
from service.composition.settings import Settings, setting_entries
from service.core.estimation.filtering.row_block import EXCLUSIONS
from service.core.geometry.frames import AntennaDirection
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.control.command.control_design import CONTROL_INHIBITIONS
from service.pipeline.control.release.command_states import (
    COMMAND_TRANSITIONS,
    REFUSALS,
    TRANSITIONS,
    CommandState,
    CommandTransition,
    Guard,
    State,
    Trigger,
)
from service.pipeline.control.release.interlock_conditions import Condition
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.records.levels.attitude import Status
from service.records.levels.measurement import QualityFlag
from service.records.operations.alarms import ChangeKind
from service.records.setting import ORIGINS

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reference" / "alarms.md"


def test_the_page_is_drawn_from_the_tables() -> None:
    assert PAGE.read_text() == reference_pages.alarms_page(), "run: python -m docs.reference_pages"
    assert reference_pages.alarm_diagram() in PAGE.read_text()


def test_every_condition_and_every_change_stands_on_the_page() -> None:
    text = PAGE.read_text()
    for name in condition_table(AlarmConfig(), RobustConfig()):
        assert text.count(f"`{name}`") >= 2, name
    for kind in ChangeKind:
        assert f"| {kind.value} |" in text


DOCUMENT = json.loads((ROOT / "docs" / "reference" / "openapi.json").read_text())


def test_the_types_are_those_of_the_document() -> None:
    path = ROOT / "service" / "client" / "documents.py"
    assert path.read_text() == client_types(DOCUMENT), "run make schema"


def test_every_type_has_the_fields_of_its_schema() -> None:
    for schema, name in TYPES.items():
        properties = DOCUMENT["components"]["schemas"][schema]["properties"]
        assert getattr(documents, name).__annotations__.keys() == properties.keys(), name


COMMAND_PAGE = (ROOT / "docs/reference/command-line.md").read_text()
GROUP = typer.main.get_command(app)
assert isinstance(GROUP, typer.core.TyperGroup)


def commands(group, prefix=""):
    """Return every command by its words; a group of commands stands for those in it."""
    found = {}
    for name, command in group.commands.items():
        is_group = isinstance(command, typer.core.TyperGroup)
        if not is_group or command.invoke_without_command:
            found[prefix + name] = command
        if is_group:
            found |= commands(command, f"{prefix}{name} ")
    return found


COMMANDS = commands(GROUP)


def test_the_list_of_commands_says_what_each_says_itself() -> None:
    group = CliRunner().invoke(app, ["--help"], terminal_width=300)
    listed = dict(re.findall(r"^  ([a-z-]+)  +(\S.*)$", group.output.partition("Commands:")[2], re.MULTILINE))
    assert listed == {
        name: (command.help or "").split("\n\n")[0].replace("\n", " ") for name, command in GROUP.commands.items()
    }


def sections() -> dict[str, str]:
    """Return the text of each command's section."""
    return dict(re.findall(r"^## soo ([\w -]+)\n(.*?)(?=^## |\Z)", COMMAND_PAGE, re.DOTALL | re.MULTILINE))


def test_every_command_has_a_section() -> None:
    assert list(sections()) == list(COMMANDS)


@pytest.mark.parametrize("name", list(COMMANDS))
def test_options_of_a_command_are_those_of_the_code(name: str) -> None:
    rows = re.findall(r"^\| `((?:--)?[\w-]+)` \| ([^|]*) \| (.*) \|$", sections()[name], re.MULTILINE)
    wanted = [(option.opts[0], option.help) for option in COMMANDS[name].params]
    assert [(option, meaning) for option, _, meaning in rows] == wanted
    required = {option.opts[0] for option in COMMANDS[name].params if option.required}
    assert {option for option, default, _ in rows if default == "required"} == required


LEVEL_PAGE = (ROOT / "docs" / "reference" / "data-levels.md").read_text()


def rows(header: str) -> list[str]:
    """Return the first column of the table that begins with a header."""
    table = LEVEL_PAGE.split(f"| {header} |", 1)[1].split("\n\n", 1)[0]
    return re.findall(r"^\| `?(\w+)`? \|", table, re.MULTILINE)


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("status | meaning", sorted(Status)),
        ("inhibition | method | meaning", sorted(INHIBITIONS)),
        ("inhibition | meaning", sorted(CONTROL_INHIBITIONS)),
        ("reason | method | meaning", ["absent", "frozen", "group", "interference", "manual", "step", "uplink_fade"]),
    ],
)
def test_a_table_names_what_the_code_has(header: str, names: list[str]) -> None:
    assert sorted(rows(header)) == names


def test_flags_stand_beside_their_bits() -> None:
    reported = {name: int(bit) for bit, name in re.findall(r"^\| (\d+) \| `(\w+)` \|$", LEVEL_PAGE, re.MULTILINE)}
    assert reported == {flag.name: flag.value for flag in QualityFlag}


def test_reasons_of_exclusions_are_those_of_the_rows() -> None:
    files = (
        ROOT / "service" / "pipeline" / "estimation" / name for name in ("robust/attitude_rows.py", "paper/runner.py")
    )
    code = "\n".join(path.read_text() for path in files)
    reported = re.findall(r"Exclusion\([^\n]*", code) + re.findall(r"return \"[^\n]*", code)
    words = {word for line in reported for word in re.findall(r"\"(\w+)\"", line)} - {"exclusion"} | set(EXCLUSIONS[1:])
    assert words == set(rows("reason | method | meaning"))


FOLDER = Path(__file__).resolve().parents[2] / "docs/explanations/decisions"
DECISIONS = sorted(path for path in FOLDER.glob("*.md") if not path.name.startswith("0000"))


def test_numbers_follow_one_another() -> None:
    numbers = [int(path.name[:4]) for path in DECISIONS]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= 6


@pytest.mark.parametrize("path", DECISIONS, ids=lambda path: path.name)
def test_form(path: Path) -> None:
    text = path.read_text()
    assert 5 <= len(text.splitlines()) <= 60
    assert text.startswith(f"# {path.name[:4]} ")
    assert re.search(r"^Date: \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert re.search(r"^Status: (proposed|accepted|superseded by \d{4})$", text, re.MULTILINE)
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == ["Context", "Decision", "Consequences"]


#: packages that must show examples
SHOWING = ("service/core", "service/records")


def showing_modules() -> list[str]:
    """Return the modules of the service whose docstrings show examples."""
    paths = [path for path in (ROOT / "service").rglob("*.py") if "\n    >>> " in path.read_text()]
    return sorted(".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths)


@pytest.mark.parametrize("package", SHOWING)
def test_packages_show_examples(package: str) -> None:
    assert any(name.startswith(package.replace("/", ".")) for name in showing_modules())


@pytest.mark.parametrize("name", showing_modules())
def test_examples_do_what_they_show(name: str) -> None:
    failures: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    # arrays print the same whatever another test has set
    with np.printoptions(precision=8, threshold=1000, suppress=False, legacy=False):
        for test in doctest.DocTestFinder().find(importlib.import_module(name)):
            runner.run(test, out=failures.append)
    assert runner.tries > 0
    assert runner.failures == 0, "".join(failures)


GLOSSARY_PAGE = (ROOT / "docs/reference/glossary.md").read_text()
ROWS = re.findall(r"^\| ([^|]+) \| `([A-Za-z_]+)` \|", GLOSSARY_PAGE, re.MULTILINE)


def test_identifiers_exist() -> None:
    code = "\n".join(path.read_text() for folder in ("service", "db") for path in (ROOT / folder).rglob("*.py"))
    words = set(re.findall(r"\w+", code))
    assert len(ROWS) > 50, "the table was not found"
    assert [(term, name) for term, name in ROWS if name not in words] == []


def test_terms_stand_once_and_in_order() -> None:
    terms = [term.lower() for term, _ in ROWS]
    assert terms == sorted(set(terms))


def test_a_row_has_four_cells() -> None:
    rows = [line for line in GLOSSARY_PAGE.splitlines() if line.startswith("|")]
    assert [row for row in rows if len(re.findall(r"(?<!\\)\|", row)) != 5] == []


def test_page_is_the_tables() -> None:
    assert (ROOT / "docs/reference/interlock.md").read_text() == reference_pages.interlock_page()


def test_page_names_everything() -> None:
    page = reference_pages.interlock_page()
    for name in (*State, *Trigger, *CommandState, *CommandTransition):
        assert f"| `{name.name}` |" in page
    assert all(f"| `{condition.word}` |" in page for condition in Condition)
    assert all(len(line) <= 120 for line in page.splitlines())


def test_diagrams_draw_every_change() -> None:
    for row in TRANSITIONS:
        if row.source is not row.target:
            lines = reference_pages.interlock_diagram().splitlines()
            (line,) = [each for each in lines if f" {row.source.name} --> {row.target.name}:" in each]
            assert row.trigger.name in line
    for life, turns in COMMAND_TRANSITIONS.items():
        for turn, target in turns.items():
            assert f"    {life.name} --> {target.name}: {turn.name}" in reference_pages.command_diagram().splitlines()


def test_every_order_that_may_fail_has_a_code_and_every_guard_a_row() -> None:
    assert set(REFUSALS) == {Trigger.ARM, Trigger.ENGAGE, Trigger.DISENGAGE, Trigger.RESET}
    assert {row.guard for row in TRANSITIONS} == set(Guard)


def test_page_and_pictures_are_current(tmp_path: Path) -> None:
    for folder in ("explanations", "images"):
        (tmp_path / folder).mkdir()
    subprocess.run([sys.executable, "-m", "docs.package_map", str(tmp_path)], cwd=ROOT, check=True, timeout=300)
    drawn = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.*"))
    assert len(drawn) == 5
    for path in drawn:
        assert (ROOT / "docs" / path).read_text() == (tmp_path / path).read_text(), f"{path}: run make map"


EVIDENCE = Path(__file__).resolve().parents[2] / "docs" / "evidence"


def cells_of(lines: list[str]) -> list[list[str]]:
    """Return the cells of each line of a table."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def tables(study: str) -> tuple[list[list[str]], list[list[str]]]:
    """Return the table of a page and the one that its command prints."""
    outcome = CliRunner().invoke(app, ["study", study, "--markdown"])
    assert outcome.exit_code == 0, outcome.output
    printed = cells_of([line for line in outcome.stdout.splitlines() if line.startswith("|")])
    text = (EVIDENCE / f"{study}.md").read_text().splitlines()
    start = text.index(next(line for line in text if line.startswith("| figure |")))
    written = cells_of(text[start : start + len(printed)])
    for column in (0, 1, 2, 5):
        assert [row[column] for row in written] == [row[column] for row in printed]
    return written[2:], printed[2:]


@pytest.mark.slow
def test_orbital_frame() -> None:
    for written, printed in zip(*tables("orbital-frame"), strict=True):
        if printed[4] == "-":
            assert figure(written) == pytest.approx(figure(printed), rel=0.02, abs=1e-3), written
        else:
            assert float(written[4]) == pytest.approx(float(printed[4]), abs=0.02), written


@pytest.mark.nightly
@pytest.mark.slow
def test_rf_attitude() -> None:
    for written, printed in zip(*tables("rf-attitude"), strict=True):
        assert figure(written) == pytest.approx(figure(printed), rel=0.05, abs=0.01), written


def figure(row: list[str]) -> float:
    """Return the reproduced figure of a row, without its unit."""
    return float(row[3].split()[0])


DEFAULTS = list(setting_entries(Settings.model_construct()))


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take away what the environment says about settings."""
    for entry in DEFAULTS:
        monkeypatch.delenv(entry.name, raising=False)


def test_page_is_current() -> None:
    page = (ROOT / "docs" / "reference" / "settings.md").read_text()
    assert page == settings_markdown(), "run: soo settings --markdown --output docs/reference/settings.md"


def test_each_setting_has_meaning_and_origin() -> None:
    assert len(DEFAULTS) == len({entry.name for entry in DEFAULTS}) >= 40
    for entry in DEFAULTS:
        assert entry.meaning, entry.name
        assert entry.origin in ORIGINS, entry.name


@pytest.mark.parametrize("name", [entry.name for entry in DEFAULTS])
def test_each_variable_reaches_its_setting(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    default = next(entry.default for entry in DEFAULTS if entry.name == name)
    special = {"SOO_CLOCK": "data", "SOO_LOG_LEVEL": "debug", "SOO_BOOTSTRAP_KEY": "a-secret"}
    special["SOO_TRUSTED_PROXIES"] = "10.0.0.1"
    special["SOO_ALLOWED_ORIGINS"] = "https://grafana.example,http://[::1]:3000"
    special |= {"SOO_LOG_FORMAT": "text", "SOO_ACCESS_LOG": "False", "SOO_METRICS_NEED_KEY": "True"}
    special |= {"SOO_ESTIMATOR": "False", "SOO_PLAIN_SESSIONS": "True"}
    special |= {"SOO_ALARM_NOTICES_FROM": "critical", "SOO_ALARM_MAIL_SECURITY": "tls"}
    is_number = re.fullmatch(r"\d+(\.\d+)?(e-?\d+)?", default)
    other = special.get(name) or (str(type_of(default)(float(default) * 2.0 or 3.0)) if is_number else f"{default}x")
    monkeypatch.setenv(name, other)
    entries = list(setting_entries(Settings.model_validate({})))
    changed = {entry.name: entry.value for entry in entries if entry.value != entry.default}
    assert list(changed) == [name]
    is_secret = isinstance(getattr(Settings.model_validate({}), name.removeprefix("SOO_").lower(), None), SecretStr)
    assert changed[name] == ("(set)" if is_secret else other)


def type_of(default: str) -> type[int] | type[float]:
    """Return the type of a number as it is printed."""
    return int if default.isdigit() else float


def test_values_in_force_are_printed_without_secrets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOO_BOOTSTRAP_KEY", "never-print-me")
    monkeypatch.setenv("SOO_INTERLOCK__VALIDITY_LIMIT_DEG", "0.35")
    result = CliRunner().invoke(app, ["settings"])
    assert result.exit_code == 0, result.output
    assert "never-print-me" not in result.output
    assert re.search(r"^\* SOO_INTERLOCK__VALIDITY_LIMIT_DEG +0\.35$", result.output, re.MULTILINE)
    assert re.search(r"^  SOO_PORT +8000$", result.output, re.MULTILINE)


PICTURE = Path(__file__).parents[2] / "docs" / "images" / "sign-convention.svg"
SPACE = "{http://www.w3.org/2000/svg}"
ATTITUDE = {"yaw": (0.5, 0.0, 0.0), "roll": (0.0, 0.5, 0.0), "pitch": (0.0, 0.0, 0.5)}
#: deg per unit of the picture: the Earth's edge is 8.7 deg from nadir
SCALE_DEG = 8.7 / 86.0


def test_each_arrow_points_where_the_station_moves():
    seen = {}
    for panel in ET.parse(PICTURE).getroot().iter(f"{SPACE}g"):  # noqa: S314 our own file
        axis = panel.get("data-axis")
        for line in panel.iter(f"{SPACE}line"):
            x1, y1, x2, y2 = (float(line.get(name)) for name in ("x1", "y1", "x2", "y2"))
            position = AntennaDirection(np.array([SCALE_DEG * x1]), np.array([-SCALE_DEG * y1]))
            turned = turned_direction(position, ATTITUDE[axis])
            moved = np.array(
                [turned.azimuth_deg - position.azimuth_deg, turned.elevation_deg - position.elevation_deg]
            )[:, 0]
            drawn = np.array([x2 - x1, y1 - y2])
            assert drawn @ moved > 0.99 * np.linalg.norm(drawn) * np.linalg.norm(moved), (axis, drawn, moved)
            seen[axis] = seen.get(axis, 0) + 1
    assert seen == {"roll": 3, "pitch": 3, "yaw": 4}


PORT_PAGE = (Path(__file__).resolve().parents[2] / "docs/reference/simulated-ports.md").read_text()


def test_options_are_those_of_the_command_line() -> None:
    actions = [action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction)]
    known = {name for action in actions[0].choices["serve"]._actions for name in action.option_strings}
    rows = re.findall(r"^\| (`--.*?) \|", PORT_PAGE, re.MULTILINE)
    assert set(re.findall(r"--[a-z-]+", " ".join(rows))) == known - {"-h", "--help"}


def test_faults_are_those_that_can_be_armed() -> None:
    rows = re.findall(r"^\| (`[a-z_, `]+`) \|", PORT_PAGE.partition("## Faults")[2], re.MULTILINE)
    assert sorted(re.findall(r"`([a-z_]+)`", " ".join(rows))) == sorted(FAULT_NAMES)
