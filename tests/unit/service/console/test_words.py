"""Words of the console: both languages say the same things, every code of the service has words, modules have none."""

import json
import re
from pathlib import Path
from typing import get_args

import pytest

from service.api.schemas.operations import OperationKind
from service.console import pages
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.control.command.control_inhibitions import CONTROL_INHIBITIONS
from service.pipeline.control.release.control_verdict import CODES
from service.pipeline.control.release.interlock_states import State
from service.pipeline.estimation.robust.attitude_rows import ADVICE
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.records.levels.attitude import Status
from service.records.levels.carrier_results import CARRIER_HYPOTHESES, CARRIER_STATES
from service.records.levels.quality_flag import QualityFlag
from service.records.operations.access_key import Role
from service.records.operations.alarm import Severity
from service.records.operations.release import CommandState

STATIC = Path(pages.__file__).with_name("static")
ERRORS = Path(__file__).parents[4] / "docs/reference/errors.md"
MODULES = sorted(STATIC.rglob("*.js"))
LANGUAGES = {name: json.loads((STATIC / f"words/{name}.json").read_text()) for name in ("en", "ru")}
#: tests/docs compares the pages with the code
PROBLEMS = set(re.findall(r"^\| `([a-z_]+\.[a-z_]+)` \|", ERRORS.read_text(), re.MULTILINE))
CONDITIONS = condition_table(AlarmConfig(), RobustConfig()).values()
EXCLUSIONS = {"uplink_fade", "step", "absent", "frozen", "interference", "group", "manual"}
TABLES = {
    "advice": set(ADVICE),
    "alarms": {each.name for each in CONDITIONS},
    "carriers": set(CARRIER_STATES),
    "commands": {each.value for each in CommandState},
    "exclusions": EXCLUSIONS,
    "operations": set(get_args(OperationKind)),
    "flags": {each.name for each in QualityFlag},
    "hypotheses": {each for each in CARRIER_HYPOTHESES if each},
    "problems": PROBLEMS,
    "reasons": set(CODES),
    "severities": {each.word for each in Severity},
    "states": {each.name for each in State},
    "statuses": {each.value for each in Status},
}


def keys_of(level, *, path=""):
    """Return the keys of a table of words; a plural is one key."""
    if not isinstance(level, dict) or "other" in level:
        return {path}
    return {key for name, inner in level.items() for key in keys_of(inner, path=f"{path}/{name}")}


def test_both_languages_have_the_same_keys():
    assert keys_of(LANGUAGES["en"]) == keys_of(LANGUAGES["ru"])


def test_tables_of_words_are_sorted_so_that_changes_merge():
    for name, table in LANGUAGES.items():
        text = json.dumps(table, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
        assert (STATIC / f"words/{name}.json").read_text() == text, f"sort the keys of {name}.json"


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name)
def test_modules_hold_no_text_no_markup_and_no_evaluation(module):
    source = re.sub(r"/\*.*?\*/|^\s*//.*$", "", module.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert not re.search(r"\b(inner|outer)HTML\b|insertAdjacentHTML|document\.write|\beval\(|new Function", source)
    strings = re.findall(r'"((?:[^"\\\n]|\\.)*)"', source)
    # words stand in words/*.json: a text for people has a blank between words or begins a sentence
    texts = [each for each in strings if re.search(r"[A-Za-z]{2,} [a-z]{2,} |[А-я]|^[A-Z][a-z]+ [a-z]", each)]
    assert texts == []


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("language", LANGUAGES)
def test_every_code_of_the_service_has_words_and_no_other(language, name):
    table = LANGUAGES[language][name]
    assert set(table) == TABLES[name]
    assert all(set(entry) == {"name", "next"} and entry["name"] for entry in table.values())


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_unit_of_an_alarm_has_words_and_no_other(language):
    assert set(LANGUAGES[language]["units"]) == {each.unit for each in CONDITIONS}
    assert all(set(entry) == {"name"} and entry["name"] for entry in LANGUAGES[language]["units"].values())


def test_inhibitions_are_reasons():
    assert set(CODES) >= set(INHIBITIONS) | set(CONTROL_INHIBITIONS)
    assert set(LANGUAGES["en"]["app"]["role"]) == {each.value for each in Role}


def test_words_that_modules_name_exist():
    known = {key.strip("/").replace("/", ".") for key in keys_of(LANGUAGES["en"])}
    named = {key for module in MODULES for key in re.findall(r'\bwords\(\s*"([^"]+)"', module.read_text())}
    assert len(named) > 15, "the search for words finds too few"
    assert named - known == set()
