"""Tables of the control view: the diagram draws the changes of the interlock, every code that it names has words."""

import json
import re
from enum import Enum
from pathlib import Path

import pytest

from service.console import pages
from service.core.control.sign_check import SignState
from service.pipeline.control.release import release_checks
from service.pipeline.control.release.interlock_conditions import MEASURES
from service.pipeline.control.release.interlock_states import TRANSITIONS
from service.records.catalogue import ControlMode, Release
from service.records.operations.release import Purpose

STATIC = Path(pages.__file__).with_name("static")


def words_of(language):
    return json.loads((STATIC / f"words/{language}.json").read_text())["views"]["control"]


def values_of(kind: type[Enum]) -> set[str]:
    return {each.value for each in kind}


def test_the_diagram_draws_every_change_of_state():
    source = (STATIC / "parts/state_diagram.js").read_text()
    ways = set(re.findall(r'\["([A-Z]+)", "([A-Z]+)", "([A-Z]+)"\]', source))
    changes = {
        (row.source.name, row.trigger.name, row.target.name) for row in TRANSITIONS if row.source is not row.target
    }
    assert ways == changes


@pytest.mark.parametrize("language", ["en", "ru"])
def test_every_code_that_the_view_names_has_words(language):
    table = words_of(language)
    checks = set(re.findall(r'_check\("([a-z ]+)"', Path(release_checks.__file__).read_text()))
    assert set(table["check"]) == {name.replace(" ", "_") for name in checks}
    assert set(table["triggers"]) == {row.trigger.name for row in TRANSITIONS if row.source is not row.target}
    assert set(table["signState"]) == values_of(SignState) | {"running", "interrupted"}
    assert set(table["purpose"]) == values_of(Purpose)
    assert set(table["modes"]) == values_of(ControlMode)
    assert set(table["releases"]) == values_of(Release)
    units = {measure.unit.replace("%", "percent") for measure in MEASURES.values()}
    assert set(table["unit"]) >= units - {"", "s"}
