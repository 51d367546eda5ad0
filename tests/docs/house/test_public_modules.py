"""Modules that other packages import stand in their package's docstring, behind ``Public:``; others stay inside.

Only modules are held, not names: a package that imported its modules to give their names would cost every start.
"""

import ast
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[3]
ROOTS = ("service", "db", "analyzer_sim")
GRAPH = grimp.build_graph(*ROOTS, cache_dir=None)
PACKAGES = sorted(name for name in GRAPH.modules if (ROOT / name.replace(".", "/") / "__init__.py").exists())


def used_outside(package: str) -> list[str]:
    """Return the modules directly in a package that something outside of it imports."""
    children = GRAPH.find_children(package) - set(PACKAGES)
    return sorted(
        child.rpartition(".")[2]
        for child in children
        if any(not f"{user}.".startswith(f"{package}.") for user in GRAPH.find_modules_that_directly_import(child))
    )


def stated(package: str) -> list[str]:
    """Return the modules that a package's docstring calls public."""
    text = ast.get_docstring(ast.parse((ROOT / package.replace(".", "/") / "__init__.py").read_text())) or ""
    _, _, names = text.partition("\n\nPublic: ")
    return names.partition("\n\n")[0].replace("\n", " ").rstrip(".").split(", ") if names else []


@pytest.mark.parametrize("package", PACKAGES)
def test_only_public_modules_are_imported_from_outside(package: str) -> None:
    used = used_outside(package)
    assert stated(package) == used, f"if that is meant, write in its docstring: Public: {', '.join(used)}."
