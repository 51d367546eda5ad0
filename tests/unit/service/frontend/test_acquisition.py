"""Acquisition: states and pace with a scripted analyzer, jumps of the clock, cycles of sweeps as rows."""

import json
import logging
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from service.client.backoff import Backoff
from service.frontend import station as module
from service.frontend.acquisition.evaluation import MeasuredRow
from service.frontend.acquisition.states import (
    ACTIONS,
    TRANSITIONS,
    AcquisitionEvent,
    AcquisitionSettings,
    AcquisitionState,
)
from service.frontend.drivers.dialects import Features, SweepRefusedError
from service.frontend.drivers.scpi import AnalyzerMessage, Identity
from service.frontend.drivers.visa_session import AnalyzerIOError
from service.frontend.measurement_task import MeasurementTask, parse_task
from service.frontend.station import SETTLE_S, Acquisition, EpochGuard
from service.records.levels.measurement import QualityFlag, Sweep, SweepSettings


def task(**analyzer: Any) -> MeasurementTask:
    """Return a task of two sweeps with a carrier each."""
    sweep = {"start_hz": 950e6, "stop_hz": 990e6, "rbw_hz": 40e3, "points": 2001, "time_s": 2.0}
    carrier = {"symbol_rate": 1e6, "integ_bw_hz": 1.25e6, "noise": [[951e6, 954e6]]}
    document = {
        "task": {"id": "t", "analyzer": analyzer},
        "sweeps": [sweep | {"id": "a"}, sweep | {"id": "b"}],
        "carriers": [
            carrier | {"id": "c00", "sweep": "a", "fc_hz": 960e6},
            carrier | {"id": "c01", "sweep": "b", "fc_hz": 965e6},
        ],
    }
    return parse_task(json.dumps(document).encode())[0]


SETTINGS = SweepSettings(950e6, 990e6, 2001, 40e3, 42.6e3, 400e3, 2.0, "RMS")


class Script:
    """What the scripted analyzer does next, and what was asked of it."""

    def __init__(self) -> None:
        self.open_faults: list[Exception] = []
        self.take_faults: dict[str, list[Exception | None]] = {"a": [], "b": []}
        self.opened = 0
        self.closed = 0
        self.configured: list[str] = []
        self.taken = 0
        self.analyzer_messages: list[AnalyzerMessage] = []
        self.released = 0
        self.abandoned = 0
        self.level_part = 1.0
        self.is_stale = False
        self.epoch_us: Callable[[], int] = lambda: 1000 * self.taken


class ScriptedSession:
    """Session that opens or not."""

    def __init__(self, script: Script) -> None:
        if script.open_faults:
            raise script.open_faults.pop(0)
        script.opened += 1
        self._script = script

    def close(self) -> None:
        self._script.closed += 1

    def abandon(self) -> None:
        self._script.abandoned += 1


class ScriptedDriver:
    """Driver that gives a carrier of -45 dBm in every sweep."""

    def __init__(self, script: Script) -> None:
        self._script = script
        self.features = Features(has_status=True, has_dwell_epoch=True, has_clock=True)
        self.analyzer_messages = script.analyzer_messages

    def preset(self) -> None:
        pass

    foreign_changes = 0

    def configure(self, sweep: Any, path: Any) -> SweepSettings:
        self._script.configured.append(sweep.id)
        return SETTINGS

    def release(self) -> None:
        self._script.released += 1

    def measure(self, sweep: Any) -> Sweep:
        faults = self._script.take_faults[sweep.id]
        fault = faults.pop(0) if faults else None
        if fault is not None:
            raise fault
        self._script.taken += 1
        axis = np.linspace(950e6, 990e6, 2001)
        power = np.full(axis.size, 1e-7)
        power[np.abs(axis - (960e6 if sweep.id == "a" else 965e6)) < 0.5e6] = 1e-4
        power = power * self._script.level_part
        return Sweep(sweep.id, self._script.epoch_us(), SETTINGS, power, is_stale=self._script.is_stale)


def acquisition(
    monkeypatch: pytest.MonkeyPatch, script: Script, period_s: float = 0.0, **changes: Any
) -> tuple[Acquisition, list[MeasuredRow], threading.Event]:
    """Return an acquisition on a scripted analyzer, the rows it hands over, and its stop."""
    monkeypatch.setattr(module, "VisaSession", lambda *_: ScriptedSession(script))
    monkeypatch.setattr(module, "identify", lambda _: Identity("Rohde&Schwarz", "FSW", "", ""))
    monkeypatch.setattr(module, "ScpiDriver", lambda *_, **__: ScriptedDriver(script))
    rows: list[MeasuredRow] = []
    stop = threading.Event()

    def hand_over(row: MeasuredRow) -> bool:
        rows.append(row)
        return True

    # the analyzer's clock is only asked to run forward, so that scripted epochs need not keep pace with the test
    settings = AcquisitionSettings("TCPIP::analyzer::5025::SOCKET", period_s, use_analyzer_clock=True)
    made = Acquisition(task(**changes), settings, hand_over, lambda: 0, stop, Backoff(first_s=0.001, limit_s=0.002))
    return made, rows, stop


def measured(
    monkeypatch: pytest.MonkeyPatch, script: Script, count: int = 1, **changes: Any
) -> tuple[Acquisition, list[MeasuredRow]]:
    """Return an acquisition that has measured some rows, and the rows."""
    made, rows, _ = acquisition(monkeypatch, script, **changes)
    while len(rows) < count:
        made.step()
    return made, rows


def test_the_table_is_complete_and_every_fault_leads_to_the_wait() -> None:
    assert set(TRANSITIONS) == set(AcquisitionState) == set(ACTIONS)
    assert all(set(row) == set(AcquisitionEvent) for row in TRANSITIONS.values())
    working = [
        AcquisitionState.CONNECT,
        AcquisitionState.IDENTIFY,
        AcquisitionState.CONFIGURE,
        AcquisitionState.MEASURE,
    ]
    assert all(TRANSITIONS[state][AcquisitionEvent.FAULT] is AcquisitionState.BACKOFF for state in working)
    for event in (AcquisitionEvent.OK, AcquisitionEvent.FAULT, AcquisitionEvent.RESET):
        assert TRANSITIONS[AcquisitionState.BACKOFF][event] is AcquisitionState.CONNECT
    for state in AcquisitionState:
        assert TRANSITIONS[state][AcquisitionEvent.DISABLE] is AcquisitionState.DISABLED
    assert TRANSITIONS[AcquisitionState.DISABLED][AcquisitionEvent.ENABLE] is AcquisitionState.CONNECT


def test_the_way_to_the_first_row(monkeypatch: pytest.MonkeyPatch) -> None:
    made, rows, _ = acquisition(monkeypatch, Script())
    assert [made.step() for _ in range(4)] == [
        AcquisitionState.IDENTIFY,
        AcquisitionState.CONFIGURE,
        AcquisitionState.MEASURE,
        AcquisitionState.MEASURE,
    ]
    assert len(rows) == 1
    assert np.isfinite(rows[0].power_dbm).all()
    assert rows[0].flags.tolist() == [QualityFlag.SIMULATED] * 2


def test_every_sweep_is_offered_as_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    made, rows, _ = acquisition(monkeypatch, Script())
    kept: list[str] = []
    made._keep_trace = lambda sweep: kept.append(sweep.sweep_id)
    while len(rows) < 2:
        made.step()
    assert kept == ["a", "b", "a", "b"]


@pytest.mark.parametrize("fault", [AnalyzerIOError("gone"), ValueError("garbage")])
def test_a_fault_opens_another_session_and_marks_the_next_row(
    monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    script = Script()
    script.take_faults["b"] = [None, fault]
    made, rows = measured(monkeypatch, script, 3)
    assert (script.opened, script.closed) == (2, 1)
    assert [bool(row.flags[0] & QualityFlag.RECONNECTED) for row in rows] == [False, True, False]
    assert made.counters.faults == 1
    assert made.counters.last_fault == str(fault)


def test_connecting_is_tried_again_with_growing_waits(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="service.frontend.station")
    script = Script()
    script.open_faults = [AnalyzerIOError("refused")] * 3
    measured(monkeypatch, script)
    assert caplog.text.count("failed in CONNECT: refused") == 3
    assert caplog.text.count("next attempt in") == 3


def test_one_refused_sweep_leaves_the_other_good(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    script.take_faults["a"] = [SweepRefusedError("-221 Settings conflict")]
    made, rows = measured(monkeypatch, script)
    assert np.isnan(rows[0].power_dbm).tolist() == [True, False]
    assert all(flag & QualityFlag.PARTIAL_CYCLE for flag in rows[0].flags)
    assert made.counters.faults == 0


def test_all_sweeps_refused_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    script.take_faults = {"a": [SweepRefusedError("end")], "b": [SweepRefusedError("end")]}
    made, rows, _ = acquisition(monkeypatch, script)
    while made.counters.faults == 0:
        made.step()
    assert rows == []
    assert made.counters.state is AcquisitionState.BACKOFF


def test_a_stop_ends_the_run_with_the_session_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, rows, stop = acquisition(monkeypatch, script, period_s=0.005)
    thread = threading.Thread(target=made.run)
    thread.start()
    while len(rows) < 3:
        thread.join(0.005)
    stop.set()
    thread.join(120.0)
    assert not thread.is_alive()
    assert script.opened == script.closed == 1
    assert len(rows) == made.counters.rows == script.taken // 2


def test_an_overrun_is_counted_and_not_caught_up(monkeypatch: pytest.MonkeyPatch) -> None:
    made, rows, _ = acquisition(monkeypatch, Script(), period_s=10.0)
    now = {"s": 0.0}
    monkeypatch.setattr(module.time, "monotonic", lambda: now["s"])
    waits: list[float] = []
    monkeypatch.setattr(made.orders, "wait", lambda wait_s, _: waits.append(wait_s))
    while not rows:
        made.step()
    for instant_s in (25.0, 26.0):
        now["s"] = instant_s
        made.step()
    assert made.counters.overruns == 1
    # due at 0, late at 25, then at 35: nine seconds of waiting from 26
    assert waits == [pytest.approx(9.0, abs=1e-9)]


def test_what_the_analyzer_remarks_is_logged(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    script = Script()
    script.analyzer_messages.append(AnalyzerMessage(-222, "Data out of range"))
    measured(monkeypatch, script)
    assert "analyzer reports error -222 Data out of range" in caplog.text
    assert script.analyzer_messages == []


@pytest.mark.parametrize(("is_shared", "released", "first"), [(False, 0, []), (True, 2, ["a"])])
def test_settings_are_sent_when_the_sweep_changes_and_a_shared_analyzer_is_given_back_after_every_cycle(
    monkeypatch: pytest.MonkeyPatch, is_shared: bool, released: int, first: list[str]
) -> None:
    script = Script()
    measured(monkeypatch, script, 2, is_shared=is_shared)
    assert (script.released, script.configured) == (released, [*first, "a", "b", "a", "b"])


def test_no_good_row_for_three_periods_opens_another_session(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, rows, _ = acquisition(monkeypatch, script, period_s=5.0)
    now = {"s": 1000.0}
    monkeypatch.setattr(module.time, "monotonic", lambda: now["s"])
    monkeypatch.setattr(made.orders, "wait", lambda wait_s, _: now.__setitem__("s", now["s"] + wait_s))
    while not rows:
        made.step()
    script.is_stale = True
    sessions = made.counters.sessions
    # three periods of five seconds: the fourth row without a level is one too many
    while made.counters.watchdog == 0:
        made.step()
        assert len(rows) < 8
    assert len(rows) in {4, 5}
    assert made.counters.state is AcquisitionState.BACKOFF
    script.is_stale = False
    before = made.counters.good_rows
    while made.counters.good_rows == before:
        made.step()
    assert made.counters.sessions == sessions + 1
    assert rows[-1].flags[0] & QualityFlag.RECONNECTED


def test_an_order_to_rest_and_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, rows, _ = acquisition(monkeypatch, script)
    monkeypatch.setattr(made.orders, "wait", lambda *_: None)
    while not rows:
        made.step()
    made.orders.apply(is_enabled=False, resets=0)
    assert [made.step() for _ in range(3)] == [AcquisitionState.DISABLED] * 3
    assert script.closed == 1
    assert len(rows) == 1
    made.orders.apply(is_enabled=True, resets=0)
    assert made.step() is AcquisitionState.CONNECT
    while len(rows) < 2:
        made.step()
    assert made.counters.faults == 0


def test_a_reset_closes_the_session_clears_the_waits_and_keeps_the_counters(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, rows = measured(monkeypatch, script)
    made.orders.apply(is_enabled=True, resets=0)
    made.orders.apply(is_enabled=True, resets=3)
    assert made.step() is AcquisitionState.CONNECT
    assert script.closed == 1
    assert made.orders.resets_seen == 3
    made.orders.apply(is_enabled=True, resets=3)
    while len(rows) < 3:
        made.step()
    assert (made.counters.resets, made.counters.sessions, made.counters.rows) == (1, 2, 3)


def test_an_order_ends_a_long_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    script.open_faults = [AnalyzerIOError("refused")] * 2
    made, rows, stop = acquisition(monkeypatch, script)
    made._backoff = Backoff(first_s=60.0)
    thread = threading.Thread(target=made.run)
    thread.start()
    while made.counters.faults < 1:
        thread.join(0.005)
    made.orders.apply(is_enabled=True, resets=0)
    for resets in (1, 2):
        made.orders.apply(is_enabled=True, resets=resets)
        while made.counters.resets < resets:
            thread.join(0.005)
    while not rows:
        thread.join(0.005)
    stop.set()
    thread.join(120.0)
    assert not thread.is_alive()


def test_an_action_that_hangs_is_noticed_shown_and_its_line_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, _ = measured(monkeypatch, script)
    now_s = module.time.monotonic()
    made.poll()
    assert (made.is_stuck, made.counters.stuck) == (False, 0)
    made._allow(100.0)
    monkeypatch.setattr(module.time, "monotonic", lambda: now_s + 200.0)
    assert made.is_stuck
    assert [each["code"] for each in made.warnings] == ["analyzer.stuck"]
    made.poll()
    made.poll()
    assert (script.abandoned, made.counters.stuck) == (1, 1)


def test_epochs_that_run_backwards_are_flagged_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, rows, _ = acquisition(monkeypatch, script)
    epochs = iter([10_000, 10_000, 20_000, 20_000, 5_000, 5_000])
    script.epoch_us = lambda: next(epochs)
    while len(rows) < 3:
        made.step()
    assert [bool(row.flags[0] & QualityFlag.CLOCK_UNSYNC) for row in rows] == [False, False, True]
    assert made.counters.clock_jumps == 1
    assert "clock.jumped" in [each["code"] for each in made.warnings]


def test_what_the_analyzer_makes_of_a_sweep_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    script = Script()
    made, rows, _ = acquisition(monkeypatch, script)
    monkeypatch.setattr(
        ScriptedDriver, "configure", lambda *_: SweepSettings(950e6, 990e6, 751, 40e3, 42.6e3, 400e3, 2.0, "RMS")
    )
    while not rows:
        made.step()
    assert {each["code"] for each in made.warnings} == {"sweep.points"}


START_US = 1_795_230_152_000_000


def flags(jump_s: float, rows: int = 20, period_s: float = 5.0, drift: float = 0.0) -> tuple[EpochGuard, list[bool]]:
    """Return what is said of rows of which the fifth comes after a jump."""
    guard = EpochGuard(has_monotonic=True)
    reported = []
    for k in range(rows):
        epoch_us = START_US + round(1e6 * (period_s * k * (1 + drift) + (jump_s if k >= 5 else 0.0)))
        reported.append(bool(guard.judge(epoch_us, 100.0 + period_s * k) & QualityFlag.CLOCK_UNSYNC))
    return guard, reported


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 1.0, -1.0])
def test_a_jump_is_flagged_until_the_clock_has_been_even_for_a_minute(
    jump_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    guard, reported = flags(jump_s)
    assert reported == [5 <= k < 5 + SETTLE_S / 5.0 for k in range(20)]
    assert guard.jumps == 1
    assert f"went {'forward' if jump_s > 0 else 'back'} by {abs(jump_s):.3f} s" in caplog.text
    assert guard.warning == ""


@pytest.mark.parametrize("drift", [0.0, 200e-6, -500e-6])
def test_an_even_clock_is_trusted(drift: float) -> None:
    guard, reported = flags(0.0, drift=drift)
    assert not any(reported)
    assert guard.jumps == 0


def test_long_periods_of_a_slewed_clock_are_no_jump() -> None:
    guard, reported = flags(0.0, period_s=3600.0, drift=400e-6)
    assert not any(reported)
    assert guard.jumps == 0


def test_of_an_analyzers_calendar_only_the_way_back_is_seen() -> None:
    guard = EpochGuard(has_monotonic=False)
    epochs = [0, 60_000_000, 7_200_000_000, 7_200_000_000, 1_000_000]
    assert [bool(guard.judge(START_US + each, 0.01 * k)) for k, each in enumerate(epochs)] == [
        False,
        False,
        False,
        True,
        True,
    ]
