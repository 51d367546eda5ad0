"""Static files of the console, and its words: both languages alike, every code of the service has words."""

import json
import posixpath
import re
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import get_args

import httpx
import pytest
from fastapi import FastAPI

from service.api.export.export_files import OFFERED
from service.api.schemas.calibrations import ReplayDocument, Sensor
from service.api.schemas.carrier_selection import CarrierSetsAnswer, Turns
from service.api.schemas.inputs import OperationKind
from service.api.schemas.shift import SetName
from service.console import pages
from service.core.control.sign_check import SignState
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.control.command.control_design import CONTROL_INHIBITIONS
from service.pipeline.control.release import release_checks
from service.pipeline.control.release.command_states import TRANSITIONS, State
from service.pipeline.control.release.control_verdict import CODES
from service.pipeline.control.release.interlock_conditions import MEASURES
from service.pipeline.control.situation import SITUATIONS
from service.pipeline.estimation.robust.attitude_rows import ADVICE
from service.pipeline.estimation.row_inhibitions import INHIBITIONS
from service.pipeline.planning.planning import Rule
from service.records.calibration import CalibrationMethod, CalibrationState
from service.records.catalogue import ControlMode, Method, Release
from service.records.levels.attitude import CARRIER_HYPOTHESES, CARRIER_STATES, Status
from service.records.levels.measurement import QualityFlag
from service.records.operations.access import Role
from service.records.operations.alarms import ChangeKind, Cover, Process, Severity
from service.records.operations.release import CommandState, Purpose
from service.records.operations.work import JobState

pytestmark = pytest.mark.anyio


STATIC = Path(pages.__file__).with_name("static")


@pytest.fixture
async def client():
    async with httpx.AsyncClient(
        transport=httpx.ASGITransport(pages.with_console(FastAPI())), base_url="http://soo"
    ) as opened:
        yield opened


async def test_the_address_of_the_service_leads_to_the_console(client):
    for path in ("/", "/console"):
        answer = await client.get(path)
        assert (answer.status_code, answer.headers["location"]) == (307, "/console/")
    answer = await client.get("/console/")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")


async def test_all_that_the_page_names_is_served(client):
    page = (STATIC / "index.html").read_text()
    named = re.findall(r'(?:href|src)="([^"]+)"', page)
    assert len(named) > 15
    assert set(named) <= set(pages.console_files())


async def test_every_file_has_the_headers_that_keep_foreign_code_out(client):
    for name in pages.console_files():
        answer = await client.get(f"/console/{name}")
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'")
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert answer.headers["referrer-policy"] == "no-referrer"


async def test_a_file_is_sent_packed_once_and_not_again_while_it_is_the_same(client):
    packed = await client.get("/console/app.js", headers={"accept-encoding": "gzip"})
    plain = await client.get("/console/app.js", headers={"accept-encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.content == plain.content == (STATIC / "app.js").read_bytes()
    assert "content-encoding" not in plain.headers
    again = await client.get("/console/app.js", headers={"if-none-match": f'"other", {packed.headers["etag"]}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", packed.headers["etag"])
    changed = await client.get("/console/app.js", headers={"if-none-match": 'W/"other"'})
    assert changed.status_code == 200
    head = await client.head("/console/app.js")
    assert (head.status_code, head.content) == (200, b"")


@pytest.mark.parametrize("language", ["en", "ru"])
async def test_words_are_sent_whole_and_without_the_blanks_of_their_layout(client, language):
    answer = await client.get(f"/console/words/{language}.json")
    assert answer.json() == json.loads((STATIC / f"words/{language}.json").read_text())
    assert b"\n" not in answer.content


@pytest.mark.parametrize("name", ["nothing.js", "../pages.py", "..%2fpages.py", "%2e%2e/pages.py", "views", "views/"])
async def test_nothing_else_is_served(client, name):
    assert (await client.get(f"/console/{name}")).status_code in {404, 307}
    assert name not in pages.console_files()


def needed(files, name):
    """Return the names of the files that a module imports, itself included; types in comments are no imports."""
    found, waiting = set(), [name]
    while waiting:
        each = waiting.pop()
        if each not in found:
            found.add(each)
            imported = re.findall(r'^(?:import|export) [^"]*"(\.[^"]+)";', files[each].plain.decode(), re.MULTILINE)
            waiting += [posixpath.normpath(posixpath.join(posixpath.dirname(each), path)) for path in imported]
    return found


async def test_each_view_without_data_stays_small():
    files = pages.console_files()
    head = set(re.findall(r'(?:href|src)="([^"]+)"', files["index.html"].plain.decode())) & set(files)
    # whatever of uPlot is loaded, and the words of the longer language
    shell = head | needed(files, "app.js") | {"index.html", "uplot.js", "uplot.css", "words/ru.json"}
    views = [name for name in files if re.fullmatch(r"views/\w+\.js", name)]
    sizes = {name: sum(len(files[each].packed) for each in shell | needed(files, name)) for name in views}
    print(sizes)
    assert len(sizes) == 12
    assert max(sizes.values()) <= 150_000


async def test_uplot_is_served_as_npm_has_it():
    files = pages.console_files()
    assert {name: pages.sha256(files[name].plain).hexdigest() for name in ("uplot.js", "uplot.css")} == {
        "uplot.js": "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2",
        "uplot.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    }


async def test_another_uplot_is_not_served_and_the_console_is(monkeypatch, caplog):
    monkeypatch.setitem(pages._UPLOT, "uplot.js", ("uplot.iife.min.js", "0" * 64))
    files = pages.console_files()
    assert "index.html" in files
    assert not {"uplot.js", "uplot.css"} & set(files)
    assert "uplot.js of youplot is not that of uPlot 1.6.31" in caplog.text


@pytest.mark.parametrize("found", [None, []])
async def test_a_wheel_that_lists_no_files_brings_no_uplot(monkeypatch, caplog, found):
    monkeypatch.setattr(metadata, "files", lambda _: found)
    assert "uplot.js" not in pages.console_files()
    assert "pip install soo[console]" in caplog.text


async def test_without_the_wheel_the_console_is_served_and_the_log_says_what_to_install(monkeypatch, caplog):
    monkeypatch.setattr(pages, "_WHEEL", "no-such-wheel")
    files = pages.console_files()
    assert {"index.html", "app.js", "words/ru.json"} <= set(files)
    assert "uplot.js" not in files
    assert "pip install soo[console]" in caplog.text


def test_modules_and_styles_stay_few():
    lines = sum(len(path.read_text().splitlines()) for end in ("js", "css") for path in STATIC.rglob(f"*.{end}"))
    assert lines <= 6000


ERRORS = Path(__file__).parents[3] / "docs/reference/errors.md"
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
    "situations": set(SITUATIONS),
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


STATES = {each.value for each in Process} | {each.value for each in Cover if each is not Cover.NONE}


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_state_change_and_limit_set_has_words(language):
    view = LANGUAGES[language]["views"]["alarms"]
    assert set(view["state"]) == STATES
    assert set(view["change"]) == {each.value for each in ChangeKind}
    assert set(view["set"]) == set(get_args(SetName))


def test_the_view_offers_every_format_of_every_series():
    source = (STATIC / "views/archive.js").read_text()
    (tables,) = re.findall(r"const TABLES = \[(.*?)\];", source)
    (formats,) = re.findall(r"const FORMATS = \{(.*?)\};", source)
    formats = formats.replace("...TABLES", tables).replace(" TABLES", f" [{tables}]")
    found = {series: re.findall(r'"(\w+)"', offered) for series, offered in re.findall(r"(\w+): \[(.*?)\]", formats)}
    assert found == {series: list(offered) for series, offered in OFFERED.items()}


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_code_that_the_view_names_has_words(language):
    table = LANGUAGES[language]["views"]["archive"]
    assert set(table["series"]) == set(OFFERED)
    assert set(table["state"]) == {each.value for each in JobState}
    assert set(table["method"]) == {each.value for each in Method}
    assert set(table["order"]) == set(ReplayDocument.model_fields["order"].annotation.__args__)
    columns = re.findall(r"^  \w+: \[(.*)\],$", (STATIC / "views/archive.js").read_text(), re.MULTILINE)
    assert set(table["column"]) == {name for each in columns for name in re.findall(r'"(\w+)"', each)}


CALIBRATION_MODULES = [STATIC / "views/calibration.js", *sorted((STATIC / "views/calibration").glob("*.js"))]


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_code_that_the_view_of_calibrations_names_has_words(language):
    table = LANGUAGES[language]["views"]["calibration"]
    assert set(table["state"]) == {each.value for each in CalibrationState} | {"running"}
    assert set(table["method"]) == {each.value for each in CalibrationMethod}
    assert set(table["job"]) == {each.value for each in JobState}
    assert set(table["sensor"]) == set(get_args(Sensor))
    assert set(table["rule"]) == {each.value for each in Rule}
    assert set(table["turnKind"]) == {each.value for each in Turns}
    assert set(table["set"]) == set(CarrierSetsAnswer.model_fields)


def test_words_that_its_modules_name_exist():
    table = LANGUAGES["en"]["views"]["calibration"]
    named = {key for module in CALIBRATION_MODULES for key in re.findall(r'\bw\("([^"]+)"', module.read_text())}
    assert len(named) > 60, "the search for words finds too few"
    for key in sorted(named):
        level = table
        for name in key.split("."):
            level = level[name]
        assert isinstance(level, str) or "other" in level, key


def values_of(kind: type[Enum]) -> set[str]:
    return {each.value for each in kind}


def test_the_diagram_draws_every_change_of_state():
    source = (STATIC / "parts/state_diagram.js").read_text()
    ways = set(re.findall(r'\["([A-Z]+)", "([A-Z]+)", "([A-Z]+)"\]', source))
    changes = {
        (row.source.name, row.trigger.name, row.target.name) for row in TRANSITIONS if row.source is not row.target
    }
    assert ways == changes


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_code_that_the_view_of_control_names_has_words(language):
    table = LANGUAGES[language]["views"]["control"]
    checks = set(re.findall(r'_check\("([a-z ]+)"', Path(release_checks.__file__).read_text()))
    assert set(table["check"]) == {name.replace(" ", "_") for name in checks}
    assert set(table["triggers"]) == {row.trigger.name for row in TRANSITIONS if row.source is not row.target}
    assert set(table["signState"]) == values_of(SignState) | {"running", "interrupted"}
    assert set(table["purpose"]) == values_of(Purpose)
    assert set(table["modes"]) == values_of(ControlMode)
    assert set(table["releases"]) == values_of(Release)
    units = {measure.unit.replace("%", "percent") for measure in MEASURES.values()}
    assert set(table["unit"]) >= units - {"", "s"}
