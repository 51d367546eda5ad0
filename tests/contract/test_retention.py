"""Every storage drops what is older than is kept: whole days, counted, and everything else goes on."""

import numpy as np
import pytest
from sqlalchemy import select

from db.encoding.segments import DAY_US
from db.measurements import retention
from db.schema.tables import retention_mark
from service.ports import Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.measurement import CarrierDetails
from service.records.levels.trace import Ring, Trace, TraceSettings

ALWAYS = 1 << 60


@pytest.fixture
def lived(setting, make, monkeypatch):
    """A spacecraft with four days of rows, the first two of them sealed, all consumed, with attitude and commands."""
    monkeypatch.setattr(retention, "ROWS_AT_ONCE", 2)
    figures = np.ones((4, 1, 3), dtype=np.float32)
    for day in range(4):
        for row in range(3):
            details = CarrierDetails(*figures) if row == 1 else None
            setting.append([day * DAY_US + row], source="sa-1", details=details)
        setting.append([day * DAY_US + 1], source="sa-2")
    list(setting.storage.archive.seal(setting.id, 2 * DAY_US, ALWAYS))
    setting.consume(
        [
            Outcome((make.attitude_row(row), make.attitude_row(row, Method.PAPER)), make.torque_command(row))
            for row in setting.rows()
            if row.feeds_estimator
        ]
    )
    return setting


def drop(setting, series, before_us):
    return sum(dropped.rows for dropped in setting.storage.archive.drop_before(setting.id, series, before_us))


def attitude(setting, make, method=Method.ROBUST):
    rows = setting.storage.results.attitude_rows(setting.id, "live", method, make.ever, 99, None)
    return [(row.epoch_us, row.status.value) for row in rows]


@pytest.mark.parametrize("days", [1, 2, 3])
def test_measurements_go_day_by_day_from_segments_and_rows(lived, make, days):
    archive = lived.storage.archive
    assert archive.kept_from_us(lived.id, "measurements") < 0
    before, attitudes = lived.rows(), attitude(lived, make)
    # the part of a day counts as none
    assert drop(lived, "measurements", days * DAY_US + 5) == 4 * days
    assert drop(lived, "measurements", days * DAY_US + 5) == 0
    assert [row.number for row in lived.rows()] == [row.number for row in before if row.epoch_us >= days * DAY_US]
    assert archive.kept_from_us(lived.id, "measurements") == days * DAY_US
    with lived.storage._database.read() as connection:
        assert connection.scalar(select(retention_mark.c.rows_dropped)) == 4 * days
    # attitude outlives what it was computed from, and nothing is told twice
    assert attitude(lived, make) == attitudes
    pages = [lived.storage.results.attitude_rows(lived.id, "live", Method.ROBUST, make.ever, 5, None)]
    while page := lived.storage.results.attitude_rows(
        lived.id, "live", Method.ROBUST, make.ever, 5, (pages[-1][-1].epoch_us, pages[-1][-1].number)
    ):
        pages.append(page)
    assert [(row.epoch_us, row.status.value) for page in pages for row in page] == attitudes


def test_the_journal_goes_on_behind_what_was_dropped(lived):
    archive = lived.storage.archive
    drop(lived, "measurements", 3 * DAY_US)
    assert [entry.number for entry in archive.journal(lived.id, 3, 2)] == [16, 17]
    assert archive.journal(lived.id, 19, 2) == []
    list(archive.seal(lived.id, ALWAYS, ALWAYS))
    assert [entry.number for entry in archive.journal(lived.id, 3, 2)] == [16, 17]
    assert lived.append([3 * DAY_US + 9]).accepted == 1


def test_attitude_that_was_dropped_is_neither_shown_nor_awaited(lived, make):
    results = lived.storage.results
    lived.calibrate()
    lived.align(5)
    assert results.pending(lived.id, [Method.ROBUST]) == 0
    assert drop(lived, "attitude", 2 * DAY_US) == 12
    assert {epoch_us // DAY_US for epoch_us, _ in attitude(lived, make)} == {2, 3}
    assert {status for _, status in attitude(lived, make)} == {"ACQUIRED"}
    fresh = type(results)(lived.storage._database)
    assert fresh.pending(lived.id, [Method.ROBUST, Method.PAPER]) == 0
    assert [sequence for sequence, _ in results.results_after(lived.id, 0, 3)][:1] != []
    assert results.newest_attitude(lived.id, "live", Method.ROBUST).epoch_us == 3 * DAY_US + 2


def test_attitude_is_told_when_all_measurements_are_gone(lived, make):
    before = attitude(lived, make)
    drop(lived, "measurements", 4 * DAY_US)
    assert lived.rows() == []
    assert lived.storage.archive.newest_measurement(lived.id) is None
    assert attitude(lived, make) == before
    assert lived.storage.results.newest_attitude(lived.id, "live", Method.PAPER).epoch_us == 3 * DAY_US + 2


def test_commands_go_too_and_a_resumed_stream_goes_on_behind_them(lived, make):
    assert drop(lived, "torques", 2 * DAY_US) == 6
    assert len(lived.storage.results.commands(lived.id, "live", make.ever, 99, None)) == 6
    drop(lived, "attitude", 2 * DAY_US)
    (first, *_) = lived.storage.results.results_after(lived.id, 0, 2)
    assert first[1].epoch_us == 2 * DAY_US


def test_what_the_chain_has_not_consumed_stays(setting):
    setting.append([0, DAY_US])
    list(setting.storage.archive.seal(setting.id, DAY_US, ALWAYS))
    assert drop(setting, "measurements", ALWAYS) == 0
    assert len(setting.rows()) == 2


def test_traces_go_by_age(setting):
    traces = setting.storage.traces
    settings = TraceSettings(1.0, 1.0, 1.0, 1.0, 1.0)
    one = [Trace(day * DAY_US, "sweep", settings, np.zeros(3)) for day in range(3)]
    traces.append(setting.id, "sa-1", one, 5, Ring(99, 1 << 20))
    assert drop(setting, "traces", 2 * DAY_US) == 2
    assert [head.epoch_us for head in traces.heads(setting.id, Window(0, ALWAYS), 9, None)] == [2 * DAY_US]


def test_the_oldest_days_do_not_fit_a_size(lived):
    fitting_us = lived.storage.archive.fitting_us
    for series in ("measurements", "attitude", "torques"):
        assert fitting_us(lived.id, series, 1 << 30) is None
        # the newest day stays whatever it takes
        assert fitting_us(lived.id, series, 0) == 3 * DAY_US
    assert fitting_us(lived.id, "attitude", 2 * 6 * 320) == 2 * DAY_US
    assert fitting_us(lived.id, "traces", 0) is None
