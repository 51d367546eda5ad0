"""House rules that no linter knows: lengths of files and functions, no addresses in locks, no paths of machines."""

import ast
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MAX_FUNCTION_LINES = 50
#: folders whose files are held shorter than the others
SHORT_FOLDERS = ("service/core", "service/pipeline")
SHORT_FILE_LINES, FILE_LINES = 300, 400
#: directories that hold no source
SKIPPED = {".venv", ".venv-clients", ".venv-docs", ".git", "build", "dist", "node_modules"}


@cache
def source_files() -> tuple[Path, ...]:
    """Return every file under version control, or every file where there is no git."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listing.returncode == 0 and listing.stdout:
        paths = [ROOT / name for name in listing.stdout.decode().split("\0") if name]
    else:
        paths = [path for path in ROOT.rglob("*") if not SKIPPED & set(path.relative_to(ROOT).parts)]
    return tuple(path for path in paths if path.is_file())


def code_files(*folders: str) -> list[Path]:
    """Return the Python files of some folders."""
    return [
        path
        for path in source_files()
        if path.suffix == ".py" and path.relative_to(ROOT).as_posix().startswith(tuple(f"{name}/" for name in folders))
    ]


def lines_of(path: Path) -> int:
    """Return how many lines a file has."""
    return len(path.read_text().splitlines())


def test_files_stay_short() -> None:
    files = code_files("service", "db", "analyzer_sim")
    assert len(files) > 100, "the search for files finds too few"
    short = set(code_files(*SHORT_FOLDERS))
    too_long = {
        path.relative_to(ROOT).as_posix(): lines_of(path)
        for path in files
        if lines_of(path) > (SHORT_FILE_LINES if path in short else FILE_LINES)
    }
    assert too_long == {}


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """Yield name and length of each function of a file; a docstring, and the options of a command, do not count."""
    is_command_line = "cli" in path.parts
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0]
        is_docstring = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
        docstring_lines = (first.end_lineno or first.lineno) - first.lineno + 1 if is_docstring else 0
        begin = first.lineno if is_command_line else node.lineno
        yield node.name, (node.end_lineno or node.lineno) - begin + 1 - docstring_lines


def test_functions_stay_short() -> None:
    too_long = {
        f"{path.relative_to(ROOT).as_posix()}:{name}": length
        for path in code_files("service", "db", "analyzer_sim")
        for name, length in functions(path)
        if length > MAX_FUNCTION_LINES
    }
    assert too_long == {}


def test_no_file_is_named_for_nothing() -> None:
    empty_names = {"utils", "util", "helpers", "helper", "common", "misc", "manager"}
    assert [path for path in source_files() if path.suffix == ".py" and path.stem in empty_names] == []


@pytest.mark.parametrize("lock", sorted(ROOT.glob("requirements*.lock")), ids=lambda lock: lock.name)
def test_locks_name_no_address(lock: Path) -> None:
    text = lock.read_text()
    assert "--hash=sha256:" in text
    assert "://" not in text
    assert not re.search(r"^\s*(-i|--index-url|--extra-index-url|--find-links|--trusted-host)\b", text, re.MULTILINE)


def test_no_file_names_a_place_on_a_machine() -> None:
    # written in two parts, so that this file does not find itself
    positions = re.compile(
        "|".join(rf"(?<![\w.])/{name}/" for name in ("root", "work/main", "home/\\w+", "Users/\\w+"))
    )
    found = [
        path.relative_to(ROOT).as_posix()
        for path in source_files()
        if path.suffix not in {".png", ".lock"} and positions.search(path.read_text(errors="replace"))
    ]
    assert found == []
