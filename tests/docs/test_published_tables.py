"""Tables of published figures: each page of evidence holds what its command prints."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli.app import app

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
