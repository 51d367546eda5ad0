"""Durations of a run of tests by group, from its JUnit files: ``python tests/durations.py build/tests/*.xml``.

Each file holds one step of a run. Wall time is the sum over the tests; processor time includes the processes that a
test waited for (tests/conftest.py counts it). A fixture that several tests share is counted with the first of them.
"""

import argparse
import platform
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

SLOWEST = 20
LANDINGS = Path(__file__).parents[1] / "docs/evidence/landings.md"
_PAGE = """# Nightly tests

Made by `make nightly` after landing {landing}, with Python {python}: what continuous integration does not repeat with
every [landing](landings.md). What is missing from the table did not run. A run that is ten landings old fails
`tests/docs/test_house_rules.py`.

{table}
"""


@dataclass
class Group:
    """Tests of one folder in one step."""

    passed: int = 0
    failed: int = 0
    skipped: int = 0
    wall_s: float = 0.0
    processor_s: float = 0.0

    def add(self, outcome: str, wall_s: float, processor_s: float) -> None:
        """Count a test."""
        setattr(self, outcome, getattr(self, outcome) + 1)
        self.wall_s += wall_s
        self.processor_s += processor_s


@dataclass(frozen=True)
class Test:
    """One test of a run."""

    step: str
    name: str
    outcome: str
    wall_s: float
    processor_s: float

    @property
    def group(self) -> str:
        """Step and folder, of unit tests with the part of the product."""
        folders = self.name.split(".")[1:]
        return f"{self.step}: {'/'.join(folders[: 3 if folders[0] == 'unit' else 1])}"


def read(path: Path) -> Iterable[Test]:
    """Yield the tests of a file."""
    for case in ET.parse(path).iter("testcase"):  # noqa: S314 -- pytest wrote it just now
        failed = case.find("failure") is not None or case.find("error") is not None
        outcome = "failed" if failed else "skipped" if case.find("skipped") is not None else "passed"
        values = (each.get("value") for each in case.iter("property") if each.get("name") == "processor_s")
        name = f"{case.get('classname')}.{case.get('name')}"
        yield Test(path.stem, name, outcome, float(case.get("time", 0.0)), float(next(values, None) or 0.0))


def by_group(tests: Iterable[Test]) -> dict[str, Group]:
    """Return the groups in order of their wall time, then their sum."""
    groups: dict[str, Group] = {}
    total = Group()
    for test in tests:
        for group in (groups.setdefault(test.group, Group()), total):
            group.add(test.outcome, test.wall_s, test.processor_s)
    return {**dict(sorted(groups.items(), key=lambda item: -item[1].wall_s)), "all": total}


def table(groups: dict[str, Group]) -> list[str]:
    """Return the lines of a Markdown table."""
    head = "| group | passed | failed | skipped | minutes | processor, min |"
    return [
        head,
        "|---|---:|---:|---:|---:|---:|",
        *(
            f"| {name} | {group.passed} | {group.failed} | {group.skipped} | {group.wall_s / 60.0:.1f} "
            f"| {group.processor_s / 60.0:.1f} |"
            for name, group in groups.items()
        ),
    ]


def slowest(tests: Sequence[Test]) -> list[str]:
    """Return a line for each of the slowest tests."""
    longest = sorted(tests, key=lambda test: -test.wall_s)[:SLOWEST]
    return [f"{test.wall_s:7.1f} s, processor {test.processor_s:6.1f} s  {test.name}" for test in longest]


def newest_landing() -> int:
    """Return the number of the newest landing."""
    return max(int(number) for number in re.findall(r"^\| (\d+) \|", LANDINGS.read_text(), re.MULTILINE))


def main() -> None:
    """Print the table and the slowest tests; with a page, write the table there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--page", type=Path, help="Markdown page of the table")
    options = parser.parse_args()
    tests = [test for path in options.files for test in read(path)]
    lines = table(by_group(tests))
    print("\n".join([*lines, "", *slowest(tests)]))
    if options.page:
        values = {"landing": newest_landing(), "python": platform.python_version(), "table": "\n".join(lines)}
        options.page.write_text(_PAGE.format(**values))
    sys.exit(any(test.outcome == "failed" for test in tests))


if __name__ == "__main__":
    main()
