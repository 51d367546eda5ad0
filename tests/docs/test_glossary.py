"""Every identifier of the glossary stands in the code base, and every term stands once and in order."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROWS = re.findall(r"^\| ([^|]+) \| `([A-Za-z_]+)` \|", (ROOT / "docs/reference/glossary.md").read_text(), re.MULTILINE)


def test_identifiers_exist() -> None:
    code = "\n".join(path.read_text() for folder in ("service", "db") for path in (ROOT / folder).rglob("*.py"))
    words = set(re.findall(r"\w+", code))
    assert len(ROWS) > 50, "the table was not found"
    assert [(term, name) for term, name in ROWS if name not in words] == []


def test_terms_stand_once_and_in_order() -> None:
    terms = [term.lower() for term, _ in ROWS]
    assert terms == sorted(set(terms))
