"""Mutants: one small error each in the core, the pipeline, the storage and the release, run against their tests.

Every mutant changes one comparison, operator, number, boolean or return value of one function. The tests are those of
its package: the folder of ``tests/unit`` that mirrors it and every file of the property, contract and regression tests
that imports its module. Mutants are drawn by a seed, as many from each group, and applied to a copy of the tree.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, zip_longest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GROUPS = {
    "release": ("service/pipeline/control/release", "service/runtime/control"),
    "core": ("service/core",),
    "pipeline": ("service/pipeline",),
    "db": ("db",),
}
TREES = ("service", "db", "analyzer_sim", "tests", "docs", "bench", "deploy")
NAMING = ("unit", "property", "contract", "regression")
#: bounds endless loops
TEST_S, MUTANT_S = 120, 900
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One replaced stretch of one file, in bytes."""

    path: str
    line: int
    start: int
    stop: int
    kind: str
    was: str
    becomes: str

    def apply(self, tree: Path) -> None:
        """Write the changed file into a copy of the tree."""
        source = (ROOT / self.path).read_bytes()
        (tree / self.path).write_bytes(source[: self.start] + self.becomes.encode() + source[self.stop :])

    def restore(self, tree: Path) -> None:
        """Write the file as it was."""
        (tree / self.path).write_bytes((ROOT / self.path).read_bytes())


def variant(node: ast.AST) -> tuple[str, ast.AST] | None:
    """Return kind and replacement of a node that can be mutated."""
    match node:
        case ast.Compare(left, [operator], [right]) if type(operator) in SWAPS:
            return "comparison", ast.Compare(left, [SWAPS[type(operator)]()], [right])
        case ast.BinOp(left, operator, right) if type(operator) in SWAPS:
            return "arithmetic", ast.BinOp(left, SWAPS[type(operator)](), right)
        case ast.BoolOp(operator, values):
            return "boolean", ast.BoolOp(SWAPS[type(operator)](), values)
        case ast.UnaryOp(ast.Not(), operand):
            return "boolean", operand
        case ast.Constant(bool(value)):
            return "boolean", ast.Constant(not value)
        case ast.Constant(int(value)):
            return "constant", ast.Constant(value + 1)
        case ast.Constant(float(value)):
            return "constant", ast.Constant(value * 1.5 + (value == 0.0))
        case ast.Return(value) if value is not None and not isinstance(value, ast.Constant):
            return "return", ast.Return(ast.Constant(None))
    return None


def computing(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that compute: no annotation, and nothing that only types read."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child
                yield from computing(child)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file's functions."""
    source = path.read_bytes()
    starts = [0, *(k + 1 for k, byte in enumerate(source) if byte == 10)]
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    for node in {id(node): node for function in functions for node in computing(function)}.values():
        if (changed := variant(node)) is None:
            continue
        start, stop = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
        becomes = ast.unparse(ast.fix_missing_locations(changed[1]))
        if not isinstance(node, ast.Return):
            becomes = f"({becomes})"
        was = source[start:stop].decode()
        yield Mutant(str(path.relative_to(ROOT)), node.lineno, start, stop, changed[0], was, becomes)


def drawn(seed: int, count: int) -> list[Mutant]:
    """Return mutants in an order in which every group comes in turn."""
    chance, taken, queues = random.Random(seed), set[Path](), []
    for folders in GROUPS.values():
        files = sorted(set(chain.from_iterable((ROOT / one).rglob("*.py") for one in folders)) - taken)
        taken |= set(files)
        every = [mutant for file in files for mutant in mutants_of(file)]
        queues.append(chance.sample(every, count))
    return [one for group in zip_longest(*queues) for one in group][:count]


def tests_of(path: str) -> list[str]:
    """Return the test files of a module's package."""
    module = Path(path).with_suffix("")
    dotted = ".".join(module.parts)
    found = set((ROOT / "tests" / "unit" / module.parent).glob("test_*.py"))
    for folder in NAMING:
        found |= {file for file in (ROOT / "tests" / folder).rglob("test_*.py") if dotted in file.read_text()}
    if module.parts[0] == "db":  # contracts speak to the storage through its ports and name no module
        found |= set((ROOT / "tests" / "contract").glob("test_*.py"))
    # those of the module itself come first: most mutants end there
    return sorted((str(file.relative_to(ROOT)) for file in found), key=lambda one: (module.stem not in one, one))


def run_tests(tree: Path, tests: list[str], markers: str, *options: str) -> tuple[int, str]:
    """Return the exit code of a run of tests in a copy of the tree, and its last lines."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:randomly", "-p", "no:cacheprovider", "-m", markers]
    command += ["--hypothesis-seed=0", f"--timeout={TEST_S}", "--tb=no", "-rfE", *options, *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / ".numba")}
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=MUTANT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return 1, "no end"
    return done.returncode, done.stdout


def failures(output: str) -> list[str]:
    """Return the tests that a run reports as failed."""
    lines = [line.split(" - ")[0] for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return [line.split(" ", 1)[1] for line in lines]


class Judge:
    """Verdicts about mutants in a copy of the tree; a test that fails without a mutant kills none."""

    def __init__(self, tree: Path, markers: str) -> None:
        self.tree, self.markers = tree, markers
        self.sound: dict[str, bool] = {}

    def is_sound(self, test: str) -> bool:
        """Return whether a test passes without a mutant."""
        if test not in self.sound:
            self.sound[test] = run_tests(self.tree, [test], self.markers)[0] == 0
        return self.sound[test]

    def killer(self, mutant: Mutant) -> str:
        """Return the test that kills a mutant, empty where none does."""
        if not (tests := tests_of(mutant.path)):
            return ""
        while True:
            unsound = [f"--deselect={test}" for test, passes in self.sound.items() if not passes]
            mutant.apply(self.tree)
            code, output = run_tests(self.tree, tests, self.markers, "-x", *unsound)
            mutant.restore(self.tree)
            if code in (0, 5):
                return ""
            # no name: the tests could not be collected or did not end
            test = (failures(output) or ["-"])[0]
            if "::" not in test or self.is_sound(test):
                return test


def copied(tree: Path) -> None:
    """Copy all that tests read."""
    for name in TREES:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for file in (*ROOT.glob("*.*"), ROOT / "Makefile", ROOT / "Dockerfile"):
        if file.is_file():
            shutil.copy(file, tree)


def main() -> None:
    """Draw, run, print one line a mutant and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=13)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the mutants to run")
    parser.add_argument("--markers", default="not nightly and not slow")
    options = parser.parse_args()
    chosen = dict(enumerate(drawn(options.seed, options.count), 1))
    chosen = {number: one for number, one in chosen.items() if not options.only or number in options.only}
    print(f"seed {options.seed}, {len(chosen)} of {options.count} mutants, tests: {options.markers}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        copied(Path(folder))
        judge, killed = Judge(Path(folder), options.markers), 0
        for number, one in chosen.items():
            killer = judge.killer(one)
            killed += bool(killer)
            position = f"{one.path}:{one.line}"
            print(f"{number:2} {one.kind} {position} {one.was} -> {one.becomes}: {killer or 'SURVIVED'}", flush=True)
    print(f"killed {killed} of {len(chosen)}")


if __name__ == "__main__":
    main()
