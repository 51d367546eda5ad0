"""States of a sweep, and sweeps that last their time: the instrument on a clock that the test moves."""

from typing import Any

import pytest

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument, TraceNotReadyError
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress, SweepState
from analyzer_sim.lines.session import Session, command_tree
from analyzer_sim.scpi.status import OPERATION_SWEEPING, OPERATION_WAITING_FOR_TRIGGER


class Clock:
    """Seconds that pass when told."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Slow:
    """A bench whose sweeps take time."""

    def __init__(self, bench: Any) -> None:
        self.clock, self.bench, self.is_allowed = Clock(), bench, True
        self.instrument = Instrument(
            bench.source,
            TracePainter(7, IDEAL),
            lambda: self.is_allowed,
            progress=SweepProgress(Pace.REAL, self.clock),
        )
        bench.instrument = self.instrument
        bench.session = Session(self.instrument, RS, command_tree(RS))
        self.ask = bench.ask
        self.ask("INIT:CONT OFF;:SWE:POIN 201;TIME 2;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ")
        self.instrument.keep_continuous()

    def pass_time(self, seconds: float) -> None:
        self.clock.now_s += seconds
        self.instrument.complete_pending()
        self.instrument.keep_continuous()

    @property
    def condition(self) -> int:
        return self.instrument.status.operation.condition


@pytest.fixture
def slow(bench: Any) -> Slow:
    return Slow(bench)


def test_a_sweep_lasts_its_time_and_says_so(slow: Slow) -> None:
    assert slow.condition == 0
    slow.ask("INIT;*OPC")
    assert (slow.condition, slow.instrument.remaining_s) == (OPERATION_SWEEPING, 2.0)
    slow.pass_time(1.99)
    assert (slow.condition, slow.bench.source.row) == (OPERATION_SWEEPING, 0)
    assert slow.ask("*ESR?") == "128", "not yet complete; the power has been switched on"
    slow.pass_time(0.02)
    assert (slow.condition, slow.bench.source.row, slow.instrument.remaining_s) == (0, 1, None)
    assert slow.ask("*ESR?") == "1"


@pytest.mark.parametrize("question", ["*OPC?", "TRAC? TRACE1", "*WAI;*OPC?"])
def test_questions_about_the_sweep_are_held_until_it_is_over(slow: Slow, question: str) -> None:
    slow.ask("INIT")
    assert slow.ask(question) == ""
    assert slow.bench.session.is_held
    slow.pass_time(2.01)
    assert slow.bench.go_on() != b""
    assert not slow.bench.session.is_held


def test_init_while_sweeping_is_ignored_and_said(slow: Slow) -> None:
    slow.ask("INIT")
    slow.pass_time(1.0)
    slow.ask("INIT")
    assert slow.bench.errors() == [-213]
    assert slow.instrument.remaining_s == pytest.approx(1.0)


def test_a_setting_restarts_the_sweep_with_its_own_time(slow: Slow) -> None:
    slow.ask("INIT")
    slow.pass_time(1.5)
    slow.ask("SWE:TIME 3")
    assert slow.instrument.remaining_s == pytest.approx(3.0)
    slow.pass_time(1.5)
    slow.ask("FORM REAL,32;:UNIT:POW DBUV")
    assert slow.instrument.remaining_s == pytest.approx(1.5), "what does not shape the trace does not disturb the sweep"
    slow.pass_time(1.51)
    assert (slow.condition, slow.bench.source.row) == (0, 1)


def test_abort_ends_the_sweep_takes_no_row_and_completes(slow: Slow) -> None:
    slow.ask("INIT;*OPC")
    slow.pass_time(1.0)
    slow.ask("ABOR")
    assert (slow.condition, slow.bench.source.row) == (0, 0)
    assert slow.ask("*OPC?;*ESR?") == "1;129"
    assert slow.ask("TRAC? TRACE1") == ""
    assert slow.bench.errors() == [-230]
    slow.ask("INIT")
    slow.pass_time(2.01)
    assert slow.bench.source.row == 1, "the row of the sweep that was aborted is the next one's"


def test_count_makes_the_sweep_longer(slow: Slow) -> None:
    slow.ask("SWE:COUN 5;:INIT")
    assert slow.instrument.remaining_s == pytest.approx(10.0)


def test_the_sweep_begins_when_its_row_is_allowed(slow: Slow) -> None:
    slow.is_allowed = False
    slow.ask("INIT")
    slow.pass_time(10.0)
    assert (slow.condition, slow.instrument.remaining_s) == (OPERATION_WAITING_FOR_TRIGGER, None)
    slow.is_allowed = True
    slow.pass_time(0.0)
    assert (slow.condition, slow.instrument.remaining_s) == (OPERATION_SWEEPING, 2.0)
    slow.is_allowed = False
    slow.pass_time(2.01)
    assert slow.bench.source.row == 1, "a grant never shrinks"


def test_sweeps_without_end_give_fresh_data_each_sweep_time(slow: Slow) -> None:
    slow.ask("INIT:CONT ON")
    slow.pass_time(0.0)
    assert slow.condition == OPERATION_SWEEPING
    assert slow.ask("*OPC?") == "1", "nothing overlapped is pending"
    assert slow.ask("TRAC? TRACE1") == ""
    assert slow.bench.session.is_held, "the first sweep is waited for"
    slow.pass_time(2.01)
    traces = [slow.bench.go_on().decode()]
    traces.append(slow.ask("TRAC? TRACE1") + "\n")
    assert traces[1] == traces[0], "the same sweep shows the same trace"
    slow.pass_time(2.0)
    traces.append(slow.ask("TRAC? TRACE1") + "\n")
    assert traces[2] != traces[1]
    assert slow.bench.source.row == 0, "the world stands still"


def test_what_was_held_goes_on_from_the_same_place(slow: Slow) -> None:
    slow.ask("INIT:CONT ON")
    slow.pass_time(0.0)
    assert slow.ask("FREQ:OFFS?;:TRAC:DATA? TRACE1;:SWE:POIN?") == ""
    slow.pass_time(2.01)
    offset, trace, points = slow.bench.go_on().decode().strip().split(";")
    assert (offset, trace.count(","), points) == ("0", 200, "201")
    assert slow.bench.errors() == []


def test_a_setting_begins_sweeps_without_end_again(slow: Slow) -> None:
    slow.ask("INIT:CONT ON")
    slow.pass_time(0.0)
    slow.pass_time(2.01)
    assert slow.instrument.trace().level_dbm.shape == (201,)
    slow.ask("SWE:POIN 301")
    with pytest.raises(TraceNotReadyError):
        slow.instrument.trace()
    slow.pass_time(1.0)
    slow.ask("ABOR")
    assert slow.instrument.remaining_s == pytest.approx(2.0), "ABORt begins again too"
    slow.pass_time(2.01)
    assert slow.instrument.trace().level_dbm.shape == (301,)


def test_sweeps_without_end_can_be_ended_and_a_single_one_follows(slow: Slow) -> None:
    slow.ask("INIT:CONT ON")
    slow.pass_time(5.0)
    slow.ask("INIT:CONT OFF")
    slow.pass_time(0.0)
    assert slow.condition == 0
    slow.ask("INIT")
    assert slow.instrument.remaining_s == pytest.approx(2.0)
    slow.ask("INIT:CONT ON")
    slow.pass_time(0.0)
    assert (slow.condition, slow.instrument.is_pending) == (OPERATION_SWEEPING, False)


def test_device_clear_frees_the_session_and_leaves_the_sweep(slow: Slow) -> None:
    slow.ask("INIT;*OPC")
    slow.ask("*OPC?")
    slow.bench.session.clear()
    assert not slow.bench.session.is_busy
    assert slow.condition == OPERATION_SWEEPING
    slow.pass_time(2.01)
    assert slow.bench.source.row == 1
    assert slow.ask("*ESR?") == "128", "*OPC was taken back"


def test_reset_ends_the_sweep(slow: Slow) -> None:
    slow.ask("INIT;*RST")
    assert not slow.instrument.is_pending
    assert slow.bench.source.row == 0


def test_life_counts_its_changes_and_time() -> None:
    clock = Clock()
    life = SweepProgress(Pace.REAL, clock)
    assert (life.state, life.is_pending, life.remaining_s, life.is_due) == (SweepState.IDLE, False, None, False)
    life.wait()
    life.start(0.5)
    clock.now_s += 0.5
    assert (life.is_due, life.remaining_s, life.sweeps_done) == (True, None, 1)
    life.end()
    life.repeat(0.1)
    clock.now_s += 1.05
    assert (life.sweeps_done, life.is_pending, life.changes) == (10, False, 4)
