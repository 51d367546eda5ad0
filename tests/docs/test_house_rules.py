"""House rules that no linter knows: sizes of files, functions and folders, docstrings, addresses, paths of machines."""

import ast
import re
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from syntax_trees import tree_of

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("service", "db", "analyzer_sim", "bench")
FILE_LINES, FUNCTION_LINES, FOLDER_NAMES = 600, 60, 40
#: directories that hold no source
SKIPPED = {".venv", ".venv-newest", ".venv-clients", ".venv-docs", ".git", "build", "dist", "node_modules"}


@cache
def source_files() -> tuple[Path, ...]:
    """Return every file under version control, or every file where there is no git."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listing.returncode == 0 and listing.stdout:
        paths = [ROOT / name for name in listing.stdout.decode().split("\0") if name]
    else:
        paths = [path for path in ROOT.rglob("*") if not SKIPPED & set(path.relative_to(ROOT).parts)]
    return tuple(path for path in paths if path.is_file())


def code_files() -> list[Path]:
    """Return the Python files of the code."""
    return [path for path in source_files() if path.suffix == ".py" and path.relative_to(ROOT).parts[0] in FOLDERS]


def test_a_file_is_one_subject() -> None:
    files = code_files()
    assert len(files) > 100, "the search for files finds too few"
    lengths = {path.relative_to(ROOT).as_posix(): len(path.read_text().splitlines()) for path in files}
    assert {name: length for name, length in lengths.items() if length > FILE_LINES} == {}


def test_folders_stay_small() -> None:
    names_by_folder = defaultdict(set)
    for path in source_files():
        *folders, last = parts = path.relative_to(ROOT).parts
        # every package has an __init__.py: no name to choose from
        if last != "__init__.py" and parts[0] in {*FOLDERS, "tests", "docs"}:
            for depth in range(1, len(folders) + 1):
                names_by_folder["/".join(parts[:depth])].add(parts[depth])
    counts = {folder: len(names) for folder, names in names_by_folder.items()}
    assert {folder: count for folder, count in counts.items() if count > FOLDER_NAMES} == {}


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """Yield name and length of each function of a file; a docstring, and the options of a command, do not count."""
    is_command_line = "cli" in path.parts
    for node in ast.walk(tree_of(path)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0]
        is_docstring = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
        docstring_lines = (first.end_lineno or first.lineno) - first.lineno + 1 if is_docstring else 0
        begin = first.lineno if is_command_line else node.lineno
        yield node.name, (node.end_lineno or node.lineno) - begin + 1 - docstring_lines


def test_a_function_is_one_thought() -> None:
    too_long = {
        f"{path.relative_to(ROOT).as_posix()}:{name}": length
        for path in code_files()
        for name, length in functions(path)
        if length > FUNCTION_LINES
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


_SECTION = re.compile(r"^(Parameters|Attributes)\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}$|\Z)", re.MULTILINE | re.DOTALL)
DOCUMENTED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def named_in(docstring: str) -> Iterator[tuple[str, set[str]]]:
    """Yield each section and the names that it documents."""
    for section, body in _SECTION.findall(docstring):
        listed = ",".join(line.split(" : ")[0] for line in re.findall(r"^\S.*$", body, re.MULTILINE))
        yield section, {name.strip().lstrip("*") for name in listed.split(",")} - {""}


def parameters_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    """Return the names of the parameters of a function."""
    given = function.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    return {each.arg for each in every if each is not None}


def attributes_of(owner: ast.ClassDef) -> set[str]:
    """Return the fields and methods of a class, and what its methods store in self."""
    stored = {
        node.attr
        for node in ast.walk(owner)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self"
    }
    lines = [each.target for each in owner.body if isinstance(each, ast.AnnAssign)]
    methods = {each.name for each in owner.body if isinstance(each, ast.FunctionDef)}
    return stored | methods | {each.id for each in lines if isinstance(each, ast.Name)}


def names_of(node: ast.AST, section: str, classes: dict[str, ast.ClassDef]) -> set[str]:
    """Return the names that a section may use: the signature, or for a class its fields and those of its bases."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return parameters_of(node)
    assert isinstance(node, ast.ClassDef)
    own = [each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"]
    if own and section == "Parameters":
        return parameters_of(own[0])
    bases = (classes.get(ast.unparse(base).split("[")[0].split(".")[-1]) for base in node.bases)
    return attributes_of(node).union(*(names_of(base, section, classes) for base in bases if base is not None))


def test_documented_parameters_exist() -> None:
    nodes = [(path, node) for path in code_files() for node in ast.walk(tree_of(path)) if isinstance(node, DOCUMENTED)]
    classes = {node.name: node for _, node in nodes if isinstance(node, ast.ClassDef)}
    documented = [
        (f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node, section, names)
        for path, node in nodes
        for section, names in named_in(ast.get_docstring(node) or "")
    ]
    assert len(documented) > 300, "the search for sections finds too few"
    missing = {(where, section): names - names_of(node, section, classes) for where, node, section, names in documented}
    assert {where: names for where, names in missing.items() if names} == {}


def test_the_nightly_tests_ran_within_ten_landings() -> None:
    pages = [(ROOT / "docs/evidence" / name).read_text() for name in ("landings.md", "nightly.md")]
    newest = max(int(number) for number in re.findall(r"^\| (\d+) \|", pages[0], re.MULTILINE))
    ran = re.search(r"after landing (\d+)", pages[1])
    assert ran is not None
    assert newest - int(ran[1]) <= 10, "run make nightly and commit docs/evidence/nightly.md"
