"""A replay with smoothed rows: the chain as ever, and beside it rows that know more and drive nothing."""

import numpy as np
import pytest
from busy_station import BOTH, SC, at, text

from service.pipeline.config import ChainConfig
from service.records.catalogue import Method
from service.records.operations.job import Replay
from service.runtime.jobs import replay_run
from service.runtime.jobs.replay_run import ReplayRun


class KilledError(BaseException):
    """The process ends here."""


def smoothed(busy, version):
    return busy.rows(Method.ROBUST_SMOOTHED, version)


def test_robust_rows_and_torques_are_those_of_the_live_run_bit_for_bit(busy):
    version = busy.replay(1, 300, smooth=True)
    for method in BOTH:
        assert text(busy.rows(method, version)) == text(busy.rows(method))
    assert text(busy.commands(version)) == text(busy.commands())


def test_every_robust_row_in_time_has_one_smoothed_row_that_knows_more(busy):
    version = busy.replay(1, 300, smooth=True)
    robust = {row.epoch_us: row for row in busy.rows(Method.ROBUST, version) if "late" not in row.inhibitions}
    rows = smoothed(busy, version)
    assert len(rows) > 60
    assert [row.epoch_us for row in rows] == sorted(robust)
    for row in rows:
        own = robust[row.epoch_us]
        assert (row.number, row.carriers_used, row.excluded) == (own.number, own.carriers_used, own.excluded)
        assert (np.array(row.sigma_deg) <= np.array(own.sigma_deg) * (1.0 + 1e-9)).all()
    better = np.mean([row.sigma_deg.roll < 0.95 * robust[row.epoch_us].sigma_deg.roll for row in rows])
    assert better > 0.5
    # nothing came after the newest row
    assert rows[-1].lag_s == 0.0
    np.testing.assert_allclose(rows[-1].attitude_deg, robust[rows[-1].epoch_us].attitude_deg, rtol=0, atol=0)


def test_a_smoothed_row_allows_no_control_and_no_torque_carries_its_method(busy):
    version = busy.replay(1, 300, smooth=True)
    rows = smoothed(busy, version)
    assert not any(row.control_allowed or any(row.control_allowed_axes) for row in rows)
    assert all(row.inhibitions[-1] == "smoothed" for row in rows)
    commands = busy.commands(version)
    assert commands
    assert "smoothed" not in text(commands)
    assert smoothed(busy, busy.replay(1, 300)) == []


def test_a_replay_of_the_robust_method_alone_keeps_them(busy):
    version = busy.replay(1, 140, method=Method.ROBUST, commands=False, smooth=True)
    assert busy.rows(Method.PAPER, version) == []
    assert len(smoothed(busy, version)) > 60


def test_in_order_of_epoch_late_rows_are_smoothed_in_their_place(busy):
    version = busy.replay(1, 300, order="epoch", alignment_id=1, smooth=True)
    assert [row.epoch_us for row in smoothed(busy, version)] == [
        row.epoch_us for row in busy.rows(Method.ROBUST, version)
    ]


def test_one_that_was_killed_begins_again_and_gives_the_same_rows(busy, monkeypatch):
    monkeypatch.setattr(replay_run, "_CHECKPOINT_S", 0.0)
    monkeypatch.setattr(replay_run, "_OUTCOMES_AT_ONCE", 7)
    whole = busy.replay(1, 300, smooth=True)
    with monkeypatch.context() as patch:
        patch.setattr(busy.jobs, "run", lambda *_: None)
        wanted = Replay(0, at(1), at(300), None, None, 0, "journal", "", 0, smooth=True)
        version = busy.replayer.start(SC, wanted)[0].version
    reports = []

    def report(progress):
        reports.append(progress)
        if len(reports) == 5:
            raise KilledError

    with pytest.raises(KilledError):
        ReplayRun(busy.storage, ChainConfig(), SC, version).run(report)
    run = ReplayRun(busy.storage, ChainConfig(), SC, version)
    assert len(run.spans(1)) == 1
    run.run(lambda _: None)
    assert text(smoothed(busy, version)) == text(smoothed(busy, whole))
    assert text(busy.rows(Method.ROBUST, version)) == text(busy.rows(Method.ROBUST, whole))
