"""A station file names analyzers, each with a source of its own."""

import json
from pathlib import Path
from typing import Any

import pytest

from service.frontend.measurement_task import TaskError
from service.frontend.tasks.station_file import load_station


def written(folder: Path, document: Any) -> Path:
    """Return a station file."""
    path = folder / "station.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("is_bare", [True, False])
def test_a_list_of_analyzers(tmp_path: Path, is_bare: bool) -> None:
    entries = [
        {"task": "ku.json", "spacecraft": "sc-1"},
        {
            "task": "c.json",
            "spacecraft": "sc-1",
            "source": "sa-2",
            "resource": "TCPIP::b::hislip0::INSTR",
            "period_s": 5,
        },
    ]
    first, second = load_station(written(tmp_path, entries if is_bare else {"analyzers": entries}))
    assert first.task == tmp_path / "ku.json"
    assert (first.source, first.period_s, first.epoch) == ("sa-1", None, "system")
    assert (second.source, second.resource, second.period_s) == ("sa-2", "TCPIP::b::hislip0::INSTR", 5.0)


@pytest.mark.parametrize(
    "document",
    [
        [],
        {},
        [{"task": "a.json"}],
        [{"task": "a.json", "spacecraft": "s", "epoch": "sundial"}],
        [{"task": "a.json", "spacecraft": "s", "period_s": -1}],
        [{"task": "a.json", "spacecraft": "s"}, {"task": "b.json", "spacecraft": "s"}],
        [{"task": "a.json", "spacecraft": "s", "colour": "red"}],
    ],
)
def test_what_is_no_station_is_refused(tmp_path: Path, document: Any) -> None:
    with pytest.raises(TaskError, match=r"station\.json"):
        load_station(written(tmp_path, document))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"absent\.json"):
        load_station(tmp_path / "absent.json")
