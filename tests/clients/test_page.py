"""The page of clients says what these tests do: one row a client, transport, dialect and work."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "analyzer-clients.md"


def expected_rows(items, version_of):
    """Return the rows of the table, from the marks of the tests."""
    rows = set()
    for item in items:
        client = item.get_closest_marker("client")
        if client is not None:
            cannot = item.get_closest_marker("xfail")
            result = f"cannot: {cannot.kwargs['reason']}" if cannot else "works"
            row = client.kwargs
            cells = (client.args[0], version_of(client.args[0]), row["transport"], row["dialect"], row["work"], result)
            rows.add("| " + " | ".join(cells) + " |")
    return sorted(rows)


def test_page_lists_what_is_tested(request, version_of):
    if len({item.path for item in request.session.items}) < len(list(Path(__file__).parent.glob("test_*.py"))):
        pytest.skip("not all clients were collected")
    expected = [row for row in expected_rows(request.session.items, version_of) if "not installed" not in row]
    shown = re.findall(r"^\| [\w-]+ \| [\d.]+ \|.*\|$", PAGE.read_text(), re.MULTILINE)
    missing = [row for row in expected if row not in shown]
    assert not missing, "put into the page:\n" + "\n".join(missing)
    if any(row.startswith("| lxi-tools") for row in expected):
        assert not set(shown) - set(expected), "take out of the page"
