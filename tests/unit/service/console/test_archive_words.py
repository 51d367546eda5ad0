"""Tables of the archive view: it offers what the service writes, and every code that it names has words."""

import json
import re
from pathlib import Path

import pytest

from service.api.export.export_files import OFFERED
from service.api.schemas.replays import ReplayDocument
from service.console import pages
from service.records.catalogue import Method
from service.records.operations.job import JobState

STATIC = Path(pages.__file__).with_name("static")


def test_the_view_offers_every_format_of_every_series():
    source = (STATIC / "views/archive.js").read_text()
    (tables,) = re.findall(r"const TABLES = \[(.*?)\];", source)
    (formats,) = re.findall(r"const FORMATS = \{(.*?)\};", source)
    formats = formats.replace("...TABLES", tables).replace(" TABLES", f" [{tables}]")
    found = {series: re.findall(r'"(\w+)"', offered) for series, offered in re.findall(r"(\w+): \[(.*?)\]", formats)}
    assert found == {series: list(offered) for series, offered in OFFERED.items()}


@pytest.mark.parametrize("language", ["en", "ru"])
def test_every_code_that_the_view_names_has_words(language):
    table = json.loads((STATIC / f"words/{language}.json").read_text())["views"]["archive"]
    assert set(table["series"]) == set(OFFERED)
    assert set(table["state"]) == {each.value for each in JobState}
    assert set(table["method"]) == {each.value for each in Method}
    assert set(table["order"]) == set(ReplayDocument.model_fields["order"].annotation.__args__)
    columns = re.findall(r"^  \w+: \[(.*)\],$", (STATIC / "views/archive.js").read_text(), re.MULTILINE)
    assert set(table["column"]) == {name for each in columns for name in re.findall(r'"(\w+)"', each)}
