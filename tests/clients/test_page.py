"""The page of clients says what these tests do: one row a client, transport, dialect and work."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "evidence" / "analyzer-clients.md"
LOCK = ROOT / "requirements-clients.lock"
#: installed by the system's package manager
UNLOCKED = {"lxi-tools"}


def shown_rows():
    """Return the cells of the table on the page."""
    lines = re.findall(r"^\| [\w-]+ \| [\d.]+ \|.*\|$", PAGE.read_text(), re.MULTILINE)
    return [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in lines]


def rows_of_marks(items):
    """Return the rows that the marks of the tests make, without versions."""
    rows = set()
    for item in items:
        client = item.get_closest_marker("client")
        if client is not None:
            cannot = item.get_closest_marker("xfail")
            result = f"cannot: {cannot.kwargs['reason']}" if cannot else "works"
            row = client.kwargs
            rows.add((client.args[0], row["transport"], row["dialect"], row["work"], result))
    return rows


def test_page_lists_what_is_tested(request):
    if len({item.path for item in request.session.items}) < len(list(Path(__file__).parent.glob("test_*.py"))):
        pytest.skip("not all clients were collected")
    shown = {(client, *others) for client, _version, *others in shown_rows()}
    tested = rows_of_marks(request.session.items)
    assert not tested - shown, "put into the page"
    assert not shown - tested, "take out of the page"


@pytest.mark.parametrize("client", sorted({row[0] for row in shown_rows()} - UNLOCKED))
def test_versions_on_the_page_are_locked(client):
    locked = set(re.findall(rf"^{client.lower()}==([\w.]+)", LOCK.read_text(), re.MULTILINE))
    assert {row[1] for row in shown_rows() if row[0] == client} <= locked
