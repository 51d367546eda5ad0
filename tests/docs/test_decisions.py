"""Decisions keep their form: number, date, status, three sections, 5 to 60 lines."""

import re
from pathlib import Path

import pytest

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
