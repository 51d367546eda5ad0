"""Mutants: each error of `sixty_mutants`, in a copy of the tree, against the quick tests.

Test files come in the order in which they are likely to find the error: those that import the function's module or lie
few imports away from it, those of its package, then all others. The first failure ends a mutant; a test that fails
without the mutant kills none.
"""

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import grimp
from sixty_mutants import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[2]
CODE = ("service", "db")
TREES = (*CODE, "analyzer_sim", "tests", "docs", "bench", "deploy")
#: no suite of these is quick, or each needs an environment of its own
SLOW = {"clients", "console", "growth", "speed", "mutation", "fakes"}
#: tests that reach a package through the interface or a port, and therefore name no module of it
THROUGH = {"db": "contract", "service/api": "api"}
#: a test is near where no more imports than these lie between it and the function
HOPS = 2
QUICK = "not nightly and not slow"
#: these bound endless loops: one test, all tests of a mutant
TEST_S, MUTANT_S = 120, 3600


class Function(NamedTuple):
    """A function or method in a file: its lines, from 0, end exclusive."""

    path: Path
    start: int
    stop: int


def _functions(node: ast.AST, scope: tuple[str, ...] = ()) -> Iterator[tuple[str, ast.AST]]:
    for child in ast.iter_child_nodes(node):
        inner = scope
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inner = (*scope, child.name)
            if not isinstance(child, ast.ClassDef):
                yield ".".join(inner), child
        yield from _functions(child, inner)


@cache
def functions_by_name() -> dict[str, list[Function]]:
    """Return every function below `CODE` by its qualified name."""
    by_name = defaultdict(list)
    for path in sorted(path for folder in CODE for path in (ROOT / folder).rglob("*.py")):
        for name, node in _functions(ast.parse(path.read_text())):
            by_name[name].append(Function(path, node.lineno - 1, node.end_lineno))
    return by_name


def mutated(mutant: Mutant) -> tuple[Path, str]:
    """Return the file of a mutant and its source with the error; LookupError says why it does not apply."""
    matches = functions_by_name().get(mutant.name, [])
    if len(matches) != 1:
        files = ", ".join(str(each.path.relative_to(ROOT)) for each in matches)
        raise LookupError(f"{len(matches)} functions are called {mutant.name}" + f": {files}" * bool(files))
    path, start, stop = matches[0]
    lines = path.read_text().splitlines(keepends=True)
    source = "".join(lines[start:stop])
    if (count := source.count(mutant.old)) != 1:
        raise LookupError(f"{mutant.name} in {path.relative_to(ROOT)} holds {mutant.old!r} {count} times, not once")
    return path, "".join((*lines[:start], source.replace(mutant.old, mutant.new), *lines[stop:]))


def _is_quick(test: Path) -> bool:
    return not SLOW & set(test.relative_to(ROOT / "tests").parts)


@cache
def test_texts() -> dict[Path, str]:
    """Return the files of quick tests and their texts."""
    return {test: test.read_text() for test in sorted((ROOT / "tests").rglob("test_*.py")) if _is_quick(test)}


@cache
def import_graph() -> grimp.ImportGraph:
    """Return the imports of the code."""
    return grimp.build_graph(*CODE, cache_dir=None)


def _imported(text: str) -> set[str]:
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom) and node.module]
    return {name for node in nodes for name in (node.module, *(f"{node.module}.{each.name}" for each in node.names))}


@cache
def imports_by_test() -> dict[Path, set[str]]:
    """Return the modules that each file of quick tests imports, by itself or by the fakes that it uses."""
    fakes = {fake.stem: _imported(fake.read_text()) for fake in (ROOT / "tests" / "fakes").rglob("*.py")}
    modules, imports = import_graph().modules, {}
    for test, text in test_texts().items():
        names = _imported(text)
        imports[test] = names.union(*(fakes[name] for name in names & fakes.keys())) & modules
    return imports


def near_tests(path: Path, name: str) -> list[Path]:
    """Return the test files that are likely to find an error of a function, likeliest first."""
    package, module = path.relative_to(ROOT).parent, ".".join(path.relative_to(ROOT).with_suffix("").parts)
    # number of imports between a module and that of the function
    hops = {module: 0}
    for hop in range(1, HOPS + 1):
        for reached in list(hops):
            for each in import_graph().find_modules_that_directly_import(reached):
                hops.setdefault(each, hop)
    calls = re.compile(rf"\b{re.escape(name.rpartition('.')[2])}\b")
    mirror = ROOT / "tests" / "unit" / package
    while not any(mirror.rglob("test_*.py")):
        mirror = mirror.parent
    through = [folder for prefix, folder in THROUGH.items() if package.as_posix().startswith(prefix)]
    ranks = {}
    for test, imports in imports_by_test().items():
        suite = test.relative_to(ROOT / "tests").parts[0]
        hop = min((hops[each] for each in imports & hops.keys()), default=HOPS + 1)
        is_of_package = test.is_relative_to(mirror)
        # tests of whole processes take longest
        if suite != "system" and (hop <= HOPS or is_of_package or suite in through):
            does_call = hop == 0 and calls.search(test_texts()[test]) is not None
            ranks[test] = (not does_call, path.stem not in test.stem, hop, not is_of_package)
    return sorted(ranks, key=lambda test: (ranks[test], test))


def run_tests(tree: Path, tests: Sequence[str], *options: str, is_compiled: bool) -> tuple[int, str]:
    """Return the exit code of quick tests in a copy of the tree, and what they printed."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:randomly", "-p", "no:cacheprovider"]
    command += ["-m", QUICK, "--hypothesis-seed=0", f"--timeout={TEST_S}", "--tb=no", "-rfE", *options, *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / ".numba")}
    if not is_compiled:
        environment["NUMBA_DISABLE_JIT"] = "1"
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=MUTANT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return 1, ""
    return done.returncode, done.stdout


class Judge:
    """Verdicts about mutants in a copy of the tree."""

    def __init__(self, tree: Path, *, is_near: bool) -> None:
        self.tree, self.is_near = tree, is_near
        self.passes: dict[tuple[str, bool], bool] = {}

    def killer(self, mutant: Mutant) -> str:
        """Return the test that kills a mutant, empty where none does."""
        path, source = mutated(mutant)
        # the compiler would take a minute for each mutant of the core: it runs as Python
        is_compiled = not path.is_relative_to(ROOT / "service" / "core")
        near = near_tests(path, mutant.name)
        others = [] if self.is_near else [test for test in test_texts() if test not in near]
        for tests in filter(None, (near, others)):
            names = [str(test.relative_to(ROOT)) for test in tests]
            if killer := self._failing(path, source, names, is_compiled=is_compiled):
                return killer
        return ""

    def _failing(self, path: Path, source: str, tests: list[str], *, is_compiled: bool) -> str:
        copy = self.tree / path.relative_to(ROOT)
        while True:
            skipped = [f"--deselect={test}" for (test, compiled), passes in self.passes.items()
                       if not passes and compiled == is_compiled]  # fmt: skip
            copy.write_text(source)
            code, output = run_tests(self.tree, tests, "-x", *skipped, is_compiled=is_compiled)
            shutil.copy(path, copy)
            if code in (0, 5):
                return ""
            failed = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", output, re.MULTILINE)
            # no test is named where they did not end
            test = failed[0] if failed else "-"
            if "::" not in test or self._is_passing(test, is_compiled=is_compiled):
                return test

    def _is_passing(self, test: str, *, is_compiled: bool) -> bool:
        """Return whether a test passes without a mutant."""
        if (test, is_compiled) not in self.passes:
            self.passes[test, is_compiled] = run_tests(self.tree, [test], is_compiled=is_compiled)[0] == 0
        return self.passes[test, is_compiled]


def copy_tree(tree: Path) -> None:
    """Copy all that tests read."""
    for name in TREES:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for file in (*ROOT.glob("*.*"), ROOT / "Makefile", ROOT / "Dockerfile", ROOT / "LICENSE"):
        if file.is_file():
            shutil.copy(file, tree)


def main() -> None:
    """Run the mutants; print one line for each, and how many were killed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the mutants to run")
    parser.add_argument("--near", action="store_true", help="leave out the tests of other packages")
    options = parser.parse_args()
    chosen = {number: one for number, one in enumerate(MUTANTS, 1) if not options.only or number in options.only}
    with tempfile.TemporaryDirectory() as folder:
        copy_tree(Path(folder))
        judge, killed = Judge(Path(folder), is_near=options.near), 0
        for number, mutant in chosen.items():
            try:
                killer = judge.killer(mutant)
            except LookupError as error:
                sys.exit(f"mutant {number} does not apply: {error}")
            killed += bool(killer)
            print(f"{number:2} {mutant.name}: {mutant.old} -> {mutant.new}: {killer or 'SURVIVED'}", flush=True)
    print(f"killed {killed} of {len(chosen)}")


if __name__ == "__main__":
    main()
