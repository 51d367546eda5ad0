"""Every identifier of the glossary stands in the code base, and every term stands once and in order."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/reference/glossary.md").read_text()
ROWS = re.findall(r"^\| ([^|]+) \| `([A-Za-z_]+)` \|", PAGE, re.MULTILINE)


def test_identifiers_exist() -> None:
    code = "\n".join(path.read_text() for folder in ("service", "db") for path in (ROOT / folder).rglob("*.py"))
    words = set(re.findall(r"\w+", code))
    assert len(ROWS) > 50, "the table was not found"
    assert [(term, name) for term, name in ROWS if name not in words] == []


def test_terms_stand_once_and_in_order() -> None:
    terms = [term.lower() for term, _ in ROWS]
    assert terms == sorted(set(terms))


def test_a_row_has_four_cells() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("|")]
    assert [row for row in rows if len(re.findall(r"(?<!\\)\|", row)) != 5] == []
