"""The page of errors names every code of the code base, and no code that the code base does not have."""

import ast
import re
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path

import pytest
from syntax_trees import tree_of

from service.api.problems.next_steps import NEXT_STEPS
from service.errors import (
    BusyError,
    ConflictError,
    ForbiddenError,
    GoneError,
    InvalidInputError,
    NotFoundError,
    StorageError,
    UnavailableError,
)

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reference" / "errors.md"
_CODE = re.compile(r"[a-z_]+\.[a-z_]+")
#: texts of the same form that are no codes
NOT_CODES = {
    "http.request": "type of an ASGI message",
    "http.disconnect": "type of an ASGI message",
    "http.response.start": "type of an ASGI message",
    "uvicorn.access": "name of a logger",
    "spacecraft.spacecraft_key": "column that foreign keys name",
}
#: codes that are put together from two parts in one function
COMPOSED = {"plan.none", "ephemeris.none", "ephemeris.unknown"}
#: codes that look like names of modules
OF_THE_SERVICE = {"service.failed", "service.not_ready"}
#: folders whose texts reach a client or the operator of a front end
FOLDERS = ("api", "formats", "frontend", "pipeline", "records", "runtime")


def code_files() -> Iterator[Path]:
    """Yield the files in which codes may stand."""
    yield ROOT / "service" / "errors.py"
    yield ROOT / "service" / "cli" / "importing" / "sending.py"
    yield from (ROOT / "db").rglob("*.py")
    for folder in FOLDERS:
        yield from (ROOT / "service" / folder).rglob("*.py")


def codes_of(path: Path) -> set[str]:
    """Return the texts of a file that have the form of a code."""
    texts = {node.value for node in ast.walk(tree_of(path)) if is_text(node)}
    return {text for text in texts if _CODE.fullmatch(text) and not text.startswith(("soo.", "service."))}


def is_text(node: ast.AST) -> bool:
    """Whether a node is a text constant."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def codes_in_use() -> set[str]:
    """Return every code of the code base."""
    found: set[str] = set().union(*(codes_of(path) for path in code_files()))
    is_file_name = re.compile(r".*\.(py|db|json|csv|mako|ini)")
    return {code for code in found if not is_file_name.fullmatch(code)} - set(NOT_CODES) | COMPOSED | OF_THE_SERVICE


def documented() -> dict[str, str]:
    """Return the codes of the page with the status or severity that it states."""
    rows = re.findall(r"^\| `([a-z_]+\.[a-z_]+)` \| (\S+) \|", PAGE.read_text(), re.MULTILINE)
    assert len(rows) == len({code for code, _ in rows}), "a code stands twice"
    return dict(rows)


def test_every_code_is_documented_and_no_other() -> None:
    in_use, page = codes_in_use(), set(documented())
    assert len(in_use) > 80, "the search for codes finds too few"
    assert in_use - page == set(), "not documented"
    assert page - in_use == set(), "documented, but not in use"


def raised(path: Path) -> Iterator[tuple[str, str]]:
    """Yield code and status of each error that a file makes with both written out."""
    status_of = {
        ForbiddenError: 403,
        NotFoundError: 404,
        ConflictError: 409,
        GoneError: 410,
        InvalidInputError: 422,
        BusyError: 429,
        UnavailableError: 503,
        StorageError: 503,
    }
    kinds = {kind.__name__: str(status) for kind, status in status_of.items()}
    for node in ast.walk(tree_of(path)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            continue
        match node.func.id, node.args:
            case kind, [ast.Constant(value=str(code)), *_] if kind in kinds:
                yield code, kinds[kind]
            case "ProblemError", [ast.Attribute(attr=name), ast.Constant(value=str(code)), *_]:
                yield code, str(int(HTTPStatus[name]))


def test_statuses_are_those_of_the_errors_raised() -> None:
    page = documented()
    found = [(path.name, code, status) for path in code_files() for code, status in raised(path)]
    assert len(found) > 40, "the search for raised errors finds too few"
    wrong = [(name, code, status) for name, code, status in found if status not in page[code].split(",")]
    assert wrong == []


def test_every_problem_and_row_has_the_next_step_of_the_table() -> None:
    # codes of measurement tasks, links and files are said by the front end, whose pages say what to do
    without = {code for code, status in documented().items() if status in {"error", "warning"}} - set(NEXT_STEPS)
    assert set(documented()) - without == set(NEXT_STEPS)
    rows = re.findall(r"^\| `([a-z_]+\.[a-z_]+)` \| \S+ \| .+ \| (.+) \|$", PAGE.read_text(), re.MULTILINE)
    assert dict(rows) == NEXT_STEPS


@pytest.mark.parametrize("code", NEXT_STEPS)
def test_a_next_step_is_one_short_sentence(code: str) -> None:
    assert re.fullmatch(r"[A-Z`].{5,110}\.", NEXT_STEPS[code])
    assert "|" not in NEXT_STEPS[code], "it stands in a table"
