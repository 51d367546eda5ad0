"""Mutants: one small error each in the core, the pipeline, the storage and the release, run against their tests.

Every mutant changes one comparison, operator, number, boolean or return value of one function. The tests are those of
its package: the folder of ``tests/unit`` that mirrors it and every file of the property, contract and regression tests
that imports its module. Mutants are drawn by a seed, as many from each group, and applied to a copy of the tree.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
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
        every = [mutant for file in files if "migrations" not in file.parts for mutant in mutants_of(file)]
        queues.append(chance.sample(every, count))
    return [one for group in zip_longest(*queues) for one in group][:count]


def tests_of(path: str) -> list[str]:
    """Return the test files of a module's package."""
    module = Path(path).with_suffix("")
    dotted = ".".join(module.parts)
    found = set((ROOT / "tests" / "unit" / module.parent).glob("test_*.py"))
    for folder in NAMING:
        found |= {file for file in (ROOT / "tests" / folder).rglob("test_*.py") if dotted in file.read_text()}
    return sorted(str(file.relative_to(ROOT)) for file in found)


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
    parser.add_argument("--first", type=int, help="run only the first so many")
    parser.add_argument("--markers", default="not nightly and not slow")
    parser.add_argument("--out", type=Path, help="lines of JSON")
    options = parser.parse_args()
    chosen = drawn(options.seed, options.count)[: options.first]
    print(f"seed {options.seed}, {len(chosen)} of {options.count} mutants, tests: {options.markers}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copied(tree)
        union = sorted({test for one in chosen for test in tests_of(one.path)})
        _, output = run_tests(tree, union, options.markers)
        sound = [f"--deselect={test}" for test in failures(output)]
        print(f"without a mutant: {output.splitlines()[-1]}", flush=True)
        killed = 0
        for number, one in enumerate(chosen, 1):
            tests = tests_of(one.path)
            one.apply(tree)
            code, output = run_tests(tree, tests, options.markers, "-x", *sound) if tests else (5, "")
            one.restore(tree)
            killed += (is_killed := code not in (0, 5))
            verdict = (failures(output) or ["stopped"])[0] if is_killed else "SURVIVED"
            print(f"{number:2} {one.kind:10} {one.path}:{one.line} {one.was} -> {one.becomes}: {verdict}", flush=True)
            if options.out:
                with options.out.open("a") as out:
                    out.write(json.dumps({**asdict(one), "killed": is_killed, "by": verdict}) + "\n")
        print(f"killed {killed} of {len(chosen)}")


if __name__ == "__main__":
    main()
