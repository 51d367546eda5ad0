"""Words of the calibration view: every code that it shows, and every key that its modules name."""

import json
import re
from pathlib import Path
from typing import get_args

import pytest

from service.api.schemas.calibrations import Sensor
from service.api.schemas.carrier_selection import CarrierSetsAnswer, Turns
from service.console import pages
from service.pipeline.planning.planning import Rule
from service.records.calibration import CalibrationMethod, CalibrationState
from service.records.operations.job import JobState

STATIC = Path(pages.__file__).with_name("static")
MODULES = [STATIC / "views/calibration.js", *sorted((STATIC / "views/calibration").glob("*.js"))]


def words_of(language):
    return json.loads((STATIC / f"words/{language}.json").read_text())["views"]["calibration"]


@pytest.mark.parametrize("language", ["en", "ru"])
def test_every_code_that_the_view_names_has_words(language):
    table = words_of(language)
    assert set(table["state"]) == {each.value for each in CalibrationState} | {"running"}
    assert set(table["method"]) == {each.value for each in CalibrationMethod}
    assert set(table["job"]) == {each.value for each in JobState}
    assert set(table["sensor"]) == set(get_args(Sensor))
    assert set(table["rule"]) == {each.value for each in Rule}
    assert set(table["turnKind"]) == {each.value for each in Turns}
    assert set(table["set"]) == set(CarrierSetsAnswer.model_fields)


def test_words_that_its_modules_name_exist():
    table = words_of("en")
    named = {key for module in MODULES for key in re.findall(r'\bw\("([^"]+)"', module.read_text())}
    assert len(named) > 60, "the search for words finds too few"
    for key in sorted(named):
        level = table
        for name in key.split("."):
            level = level[name]
        assert isinstance(level, str) or "other" in level, key
