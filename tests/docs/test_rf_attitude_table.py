"""The table of the page on the paper's attitude is the one that the command prints."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli.app import app

PAGE = Path(__file__).parents[2] / "docs" / "explanations" / "rf-attitude.md"


def _cells(lines: list[str]) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.slow
def test_table_of_the_page_is_that_of_the_command() -> None:
    outcome = CliRunner().invoke(app, ["study", "rf-attitude", "--markdown"])
    assert outcome.exit_code == 0, outcome.output
    printed = _cells([line for line in outcome.stdout.splitlines() if line.startswith("|")])
    text = PAGE.read_text().splitlines()
    start = text.index(next(line for line in text if line.startswith("| figure |")))
    written = _cells(text[start : start + len(printed)])
    assert [row[:3] for row in written] == [row[:3] for row in printed]
    assert [row[5] for row in written] == [row[5] for row in printed]
    for wrote, told in zip(written[2:], printed[2:], strict=True):
        assert float(wrote[3].split()[0]) == pytest.approx(float(told[3].split()[0]), rel=0.05, abs=0.01), wrote
