"""The reference page of the dialects is the one the tables make."""

from pathlib import Path

from analyzer_sim.dialects.dialect_page import MARKDOWN_COMMAND, markdown_page
from analyzer_sim.dialects.dialects import DIALECTS

PAGE = Path(__file__).parents[4] / "docs" / "evidence" / "simulated-analyzer.md"


def test_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == markdown_page(), f"write it again: {MARKDOWN_COMMAND} > {PAGE.name}"


def test_every_header_of_every_dialect_is_on_the_page() -> None:
    page = markdown_page().replace("\\|", "|")
    for dialect in DIALECTS.values():
        for row in dialect.commands:
            assert f"| `{row.pattern}` |" in page, row.pattern


def test_every_deviation_stands_on_the_page() -> None:
    page = " ".join(markdown_page().split())
    for dialect in DIALECTS.values():
        assert dialect.deviations
        for sentence in dialect.deviations:
            assert sentence in page
