"""Syntax trees of the sources, each parsed once for all tests of a process that look for rules in them."""

import ast
from functools import cache
from pathlib import Path


@cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file, which all tests share."""
    return ast.parse(path.read_text())
