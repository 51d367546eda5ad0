"""Docstrings: every parameter or attribute that a numpydoc section names exists in the code."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ("service", "db", "analyzer_sim", "bench")
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
    files = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    nodes = [
        (path, node) for path in files for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, DOCUMENTED)
    ]
    classes = {node.name: node for _, node in nodes if isinstance(node, ast.ClassDef)}
    documented = [
        (f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node, section, names)
        for path, node in nodes
        for section, names in named_in(ast.get_docstring(node) or "")
    ]
    assert len(documented) > 300, "the search for sections finds too few"
    missing = {(where, section): names - names_of(node, section, classes) for where, node, section, names in documented}
    assert {where: names for where, names in missing.items() if names} == {}
