"""Examples in docstrings do what they show."""

import doctest
import importlib
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
#: packages that must show examples
SHOWING = ("service/core", "service/records")


def showing_modules() -> list[str]:
    """Return the modules of the service whose docstrings show examples."""
    paths = [path for path in (ROOT / "service").rglob("*.py") if "\n    >>> " in path.read_text()]
    return sorted(".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths)


@pytest.mark.parametrize("package", SHOWING)
def test_packages_show_examples(package: str) -> None:
    assert any(name.startswith(package.replace("/", ".")) for name in showing_modules())


@pytest.mark.parametrize("name", showing_modules())
def test_examples_do_what_they_show(name: str) -> None:
    failures: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    # arrays print the same whatever another test has set
    with np.printoptions(precision=8, threshold=1000, suppress=False, legacy=False):
        for test in doctest.DocTestFinder().find(importlib.import_module(name)):
            runner.run(test, out=failures.append)
    assert runner.tries > 0
    assert runner.failures == 0, "".join(failures)
