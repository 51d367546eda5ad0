"""The how-to of analyzers says what the drivers send, and what becomes of faults, as code and tests have it."""

import json
import re
from pathlib import Path

import pytest
from fault_table import markdown_table

from service.frontend.drivers.base import SINGLE, Dialect
from service.frontend.drivers.choice import DIALECTS
from service.frontend.tasks.station_file import load_station

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
    assert markdown_table() in PAGE


def test_example_of_a_station_is_one(tmp_path: Path) -> None:
    block = re.findall(r"^```json\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[1]
    (tmp_path / "station.json").write_text(block)
    assert len(load_station(tmp_path / "station.json")) == len(json.loads(block)) == 2


def test_resources_are_names_that_can_be_opened() -> None:
    names = set(re.findall(r"TCPIP::[^\"`]+", PAGE))
    assert len(names) >= 3
    assert all(re.fullmatch(r"TCPIP::[\d.]+::(\d+::SOCKET|hislip0::INSTR)", name) for name in names)
