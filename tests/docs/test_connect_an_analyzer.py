"""The how-to of analyzers: its task, the settings that drivers send and the table of faults are those of the code."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from fault_table import markdown_table
from pydantic import BaseModel

from service.frontend.drivers.base import SINGLE, Dialect
from service.frontend.drivers.choice import DIALECTS
from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.tasks.station_file import load_station
from service.frontend.tasks.task_plan import plan_task

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
