"""The page of data levels names every status, reason and flag of the code, and no other."""

import re
from pathlib import Path

import pytest

from service.pipeline.control.command.control_inhibitions import CONTROL_INHIBITIONS
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.records.levels.attitude import Status
from service.records.levels.quality_flag import QualityFlag

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "reference" / "data-levels.md").read_text()


def rows(header: str) -> list[str]:
    """Return the first column of the table that begins with a header."""
    table = PAGE.split(f"| {header} |", 1)[1].split("\n\n", 1)[0]
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
    reported = {name: int(bit) for bit, name in re.findall(r"^\| (\d+) \| `(\w+)` \|$", PAGE, re.MULTILINE)}
    assert reported == {flag.name: flag.value for flag in QualityFlag}


def test_reasons_of_exclusions_are_those_of_the_rows() -> None:
    files = (
        ROOT / "service" / "pipeline" / "estimation" / name
        for name in ("robust/attitude_rows.py", "paper/snapshot_fix.py")
    )
    code = "\n".join(path.read_text() for path in files)
    reported = re.findall(r"Exclusion\([^\n]*", code) + re.findall(r"return \"[^\n]*", code)
    words = {word for line in reported for word in re.findall(r"\"(\w+)\"", line)}
    assert words == set(rows("reason | method | meaning"))
