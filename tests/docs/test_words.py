"""Words: one idea has one word, and retired words do not come back."""

import ast
import json
import re
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from syntax_trees import tree_of

ROOT = Path(__file__).resolve().parents[2]
#: private words of earlier versions; the glossary has the words that replaced them
RETIRED = {
    "anew", "anybody", "bear", "bears", "beside", "craft", "crafts", "deed", "deeds", "desk", "dress", "dressed",
    "landings", "obey", "owe", "owes", "somebody", "tell", "tells", "tidings", "told", "upkeep", "whoever", "wish",
    "wishes", "wreck",
}  # fmt: skip
#: words of the archive stand as they are, and so do those of the interface
KEPT = frozenset({"told_executed_us"})
RETIRED_IN_DOCUMENTS = ("tidings", "anew", "whoever", "the craft", "other people's")
#: nowhere in the code either: not in a comment, a docstring, a message or a test
RETIRED_IN_TEXT = ("anew", "whoever")
#: a docstring names its thing first; these circle it
CIRCLING = ("What", "Who", "Whether", "Those")
CIRCLING_CLASSES = (*CIRCLING, "How", "Where", "Which", "When", "Why")
FOLDERS = ("service", "db", "analyzer_sim", "bench")


@cache
def tracked() -> tuple[str, ...]:
    """Return every path under version control, or the files of the code and the documents where there is no git."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listing.returncode == 0 and listing.stdout:
        return tuple(name for name in listing.stdout.decode().split("\0") if name and (ROOT / name).is_file())
    found = (path for folder in (*FOLDERS, "tests", "docs") for path in (ROOT / folder).rglob("*"))
    return tuple(
        path.relative_to(ROOT).as_posix() for path in found if path.is_file() and "__pycache__" not in path.parts
    )


def modules(*folders: str) -> list[str]:
    """Return the Python files of some folders."""
    return [name for name in tracked() if name.endswith(".py") and name.startswith(tuple(f"{f}/" for f in folders))]


def words_of(identifier: str) -> set[str]:
    """Return the words of an identifier."""
    return set(re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", identifier).lower().split("_"))


def defined_in(tree: ast.AST) -> Iterator[str]:
    """Yield the names that a module defines, at any depth."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.arg(arg=name) | ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name


def names_of_the_interface() -> set[str]:
    """Return the fields and the schemas of the OpenAPI document."""
    document = json.loads((ROOT / "docs/reference/openapi.json").read_text())
    found = set(document["components"]["schemas"])

    def gather(value: Any) -> None:
        if isinstance(value, dict):
            properties = value.get("properties")
            found.update(properties if isinstance(properties, dict) else ())
            for inner in value.values():
                gather(inner)
        elif isinstance(value, list):
            for inner in value:
                gather(inner)

    gather(document)
    return found | {name.removesuffix("Input") for name in found}


def test_no_identifier_contains_a_retired_word() -> None:
    kept = KEPT | names_of_the_interface()
    found = defaultdict(set)
    for name in modules(*FOLDERS):
        for identifier in {Path(name).stem, *defined_in(tree_of(ROOT / name))} - kept:
            for word in words_of(identifier) & RETIRED:
                found[word].add(f"{identifier} in {name}")
    assert found == {}


def test_no_public_class_name_has_two_meanings() -> None:
    found = defaultdict(set)
    for name in modules("service", "db"):
        for node in ast.walk(tree_of(ROOT / name)):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].add(name)
    assert len(found) > 500, "the search for classes finds too few"
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_documents_are_free_of_retired_words() -> None:
    found = {
        (name, word)
        for name in tracked()
        if name.endswith(".md")
        for word in RETIRED_IN_DOCUMENTS
        if re.search(rf"\b{word}\b", (ROOT / name).read_text(), re.IGNORECASE)
    }
    assert found == set()


def test_code_is_free_of_retired_words() -> None:
    found = {
        (name, word)
        for name in modules(*FOLDERS, "tests")
        if Path(name).name != Path(__file__).name
        for word in RETIRED_IN_TEXT
        if re.search(rf"\b{word}\b", (ROOT / name).read_text(), re.IGNORECASE)
    }
    assert found == set()


def test_docstrings_name_the_thing_first() -> None:
    found = defaultdict(list)
    for name in modules(*FOLDERS):
        for node in ast.walk(tree_of(ROOT / name)):
            if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if text := ast.get_docstring(node):
                circling = CIRCLING_CLASSES if isinstance(node, ast.ClassDef) else CIRCLING
                if text.startswith(tuple(f"{word} " for word in circling)):
                    found[name].append(text.partition("\n")[0])
    assert found == {}
