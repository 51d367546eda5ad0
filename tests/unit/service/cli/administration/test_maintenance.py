"""``soo maintenance`` seals closed days and drops what is no longer kept, and says how much."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from db.storage import SqlStorage
from service.cli.app import app
from service.records.catalogue import Carrier, Site, Spacecraft
from service.records.levels.measurement import MeasurementBatch

DAY_US = 86_400_000_000
#: of 2026, long ago for the system clock of any test
FIRST_US = 20_500 * DAY_US


@pytest.fixture
def url(tmp_path):
    """An archive with a row on each of three days, consumed."""
    made = f"sqlite:///{tmp_path / 'soo.db'}"
    storage = SqlStorage(made)
    storage.prepare()
    inertia = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
    storage.catalogue.add_spacecraft(Spacecraft("craft", "craft", 90.0, Site(55.0, 38.0), inertia, 0.05))
    plan = storage.catalogue.put_plan("craft", [Carrier("c00", "C", "t0", 3.7e9, 5e6)], "sha")
    epochs_us = FIRST_US + np.arange(3) * DAY_US
    powers, stale = np.full((3, 1), -50.0, dtype=np.float32), np.zeros(3, dtype=bool)
    batch = MeasurementBatch("craft", "sa-1", plan.id, FIRST_US, np.arange(3), epochs_us, powers, (None,) * 3, stale)
    storage.archive.append_measurements(batch).result(120)
    head = storage.archive.head("craft")
    storage.results.save_outcomes("craft", "live", [], head.newest_number, head.newest_epoch_us)
    storage.close()
    return made


def reported(url, *options):
    answer = CliRunner().invoke(app, ["maintenance", "--database", url, *options])
    assert answer.exit_code == 0, answer.output
    return answer.output


def test_days_are_sealed_once(url):
    expected = {"sealed_rows": 3, "sealed_results": 0, "dropped_rows": {}, "failed_spacecraft": 0}
    assert json.loads(reported(url, "--json")) == expected
    assert json.loads(reported(url, "--json")) == expected | {"sealed_rows": 0}


def test_what_is_too_old_goes(url, monkeypatch):
    monkeypatch.setenv("SOO_RETENTION__MEASUREMENTS_DAYS", "1")
    assert reported(url) == "sealed 0 rows, 0 results\ndropped 3 rows of measurements\n"


def test_without_an_archive_the_option_is_wrong(tmp_path):
    answer = CliRunner().invoke(app, ["maintenance", "--database", f"sqlite:///{tmp_path / 'none.db'}"])
    assert answer.exit_code == 2
