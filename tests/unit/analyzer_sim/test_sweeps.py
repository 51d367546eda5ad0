"""Sweeps on a virtual clock: states, progress, faults of what is shown, and the truth as lines."""

import io
import json
from typing import Any

import numpy as np
import pytest

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.imperfections import IDEAL, TraceFault, TraceFaults
from analyzer_sim.instrument.instrument import Instrument, TraceNotReadyError
from analyzer_sim.instrument.levels import int32_block
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress, SweepState
from analyzer_sim.instrument.truth_log import Reading, TruthLog
from analyzer_sim.lines.dispatcher import Session, command_tree
from analyzer_sim.scpi.status import OPERATION_SWEEPING, OPERATION_WAITING_FOR_TRIGGER
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World


def test_sweep_waits_for_its_row_and_runs_once(bench: Any) -> None:
    bench.allow(False)
    instrument = bench.instrument
    instrument.settings.is_continuous = False
    instrument.initiate()
    assert not instrument.complete_pending()
    assert bench.source.row == 0
    bench.allow(True)
    assert (bench.source.row, instrument.is_pending) == (1, False)
    bench.allow(False)
    assert instrument.complete_pending(), "nothing is pending any more and nobody is asked"


def test_epoch_is_that_of_the_trace_shown(bench: Any) -> None:
    instrument = bench.instrument
    start_us = instrument.epoch_us()
    instrument.settings.is_continuous = False
    instrument.initiate()
    assert instrument.epoch_us() - start_us == 60_000_000
    assert instrument.trace().epoch_us == instrument.epoch_us()


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


SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:SWE:POIN 201;:INIT"


def read(bench: Any) -> np.ndarray:
    return np.array([float(word) for word in bench.ask("TRAC? TRACE1").split(",") if word])


@pytest.mark.parametrize("fault", list(TraceFault))
@pytest.mark.parametrize("number_format", ["ASC", "REAL,32"])
def test_every_fault_is_shown_once_and_only_by_a_trace(bench: Any, fault: TraceFault, number_format: str) -> None:
    bench.ask(f"{SETUP};:FORM {number_format}")
    faults = bench.instrument.trace_faults
    faults.arm(fault)
    assert bench.ask("*OPC?") == "1"
    frequencies = bench.send(b"TRAC:X? TRACE1\n")
    assert faults.remaining == 1
    wrong = bench.send(b"TRAC? TRACE1\n")
    assert faults.remaining == 0
    assert wrong != bench.send(b"TRAC? TRACE1\n")
    assert bench.send(b"TRAC:X? TRACE1\n") == frequencies
    assert bench.errors() == []


@pytest.mark.parametrize(
    ("fault", "value"),
    [
        (TraceFault.NO_RESULT, -999.0),
        (TraceFault.SCPI_NAN, 9.91e37),
        (TraceFault.SCPI_INFINITY, 9.9e37),
        (TraceFault.NAN, np.nan),
    ],
)
def test_a_tenth_of_the_points_has_the_wrong_value(bench: Any, fault: TraceFault, value: float) -> None:
    bench.ask(SETUP)
    right = read(bench)
    bench.instrument.trace_faults.arm(fault)
    wrong = read(bench)
    np.testing.assert_equal(wrong[::10], value)
    np.testing.assert_array_equal(np.delete(wrong, slice(None, None, 10)), np.delete(right, slice(None, None, 10)))


@pytest.mark.parametrize(("fault", "points"), [(TraceFault.SHORT, 200), (TraceFault.LONG, 202), (TraceFault.EMPTY, 0)])
def test_wrong_number_of_points(bench: Any, fault: TraceFault, points: int) -> None:
    bench.ask(SETUP)
    bench.instrument.trace_faults.arm(fault)
    assert len(read(bench)) == points


def test_wrong_units_are_those_of_the_instrument(bench: Any) -> None:
    bench.ask(SETUP)
    faults = bench.instrument.trace_faults
    for fault, unit in ((TraceFault.UNIT_DBUV, "DBUV"), (TraceFault.UNIT_WATT, "W")):
        faults.arm(fault)
        wrong = read(bench)
        bench.ask(f"UNIT:POW {unit}")
        np.testing.assert_allclose(wrong, read(bench), rtol=1e-5)
        bench.ask("UNIT:POW DBM")


def test_what_is_no_number_is_the_least_integer() -> None:
    block = int32_block(np.array([np.nan, -42.5]), is_big_endian=True)
    assert np.frombuffer(block[3:], ">i4").tolist() == [-(2**31), -42500]


def test_disarmed_faults_do_nothing() -> None:
    faults = TraceFaults()
    faults.arm(TraceFault.EMPTY, times=2)
    faults.disarm()
    assert faults.spoil(np.zeros(3)).shape == (3,)


class Logged:
    """A bench on a world, with its truth."""

    def __init__(self, bench: Any) -> None:
        self.world = World(scenario_named("nominal", operation_days=0.05), 3)
        self.stream = io.StringIO()
        self.truth = TruthLog(self.stream, self.world.carrier_ids, lambda: self.world.row_index)
        bench.instrument = Instrument(self.world, TracePainter(3), truth=self.truth)
        bench.session = Session(bench.instrument, RS, command_tree(RS), "socket 1")
        self.bench = bench
        bench.ask("INIT:CONT OFF;:SWE:POIN 201;:FREQ:STAR 954 MHZ;STOP 990 MHZ")

    def lines(self, kind: str) -> list[dict[str, Any]]:
        parsed = [json.loads(line) for line in self.stream.getvalue().splitlines()]
        return [line for line in parsed if line["kind"] == kind]


@pytest.fixture
def logged(bench: Any) -> Logged:
    return Logged(bench)


def test_every_sweep_is_a_line_with_the_true_powers_of_its_row(logged: Logged) -> None:
    for _ in range(3):
        logged.bench.ask("INIT;*OPC?")
    lines = logged.lines("sweep")
    assert [line["sweep"] for line in lines] == [1, 2, 3]
    for line in lines:
        row = line["row"]
        assert line["power_dbm"] == {
            name: pytest.approx(power, abs=1e-6) if is_on else None
            for name, power, is_on in zip(
                logged.world.carrier_ids,
                logged.world.rows.carrier_dbm[row].tolist(),
                logged.world.rows.is_on[row].tolist(),
                strict=True,
            )
        }
    assert len({line["row"] for line in lines}) == 3


def test_the_digest_tells_whether_settings_are_the_same(logged: Logged) -> None:
    for command in ("", "SWE:TIME 3", "SWE:TIME 3", "SWE:TIME 4"):
        logged.bench.ask(f"{command};:INIT;*OPC?")
    digests = [line["settings"] for line in logged.lines("sweep")]
    assert digests[1] == digests[2]
    assert len(set(digests)) == 3


def test_a_trace_is_a_line_once_it_has_left(logged: Logged) -> None:
    bench = logged.bench
    bench.ask("INIT;*OPC?")
    bench.ask("TRAC? TRACE1;TRAC? TRACE1")
    readings = bench.session.readings
    assert readings == (Reading(1, is_spoiled=False),) * 2
    assert logged.lines("trace") == []
    bench.session.report_delivery(readings)
    sweep = logged.lines("sweep")[0]
    expected = {key: sweep[key] for key in ("sweep", "row", "epoch")} | {"session": "socket 1", "spoiled": False}
    assert [{key: line[key] for key in expected} for line in logged.lines("trace")] == [expected] * 2


def test_what_is_no_trace_is_no_reading(logged: Logged) -> None:
    logged.bench.ask("INIT;*OPC?")
    for question in ("*IDN?", "TRAC:X? TRACE1", "TRAC? TRACE2"):
        logged.bench.ask(question)
        assert logged.bench.session.readings == ()


def test_a_trace_that_is_wrong_on_purpose_is_marked(logged: Logged) -> None:
    logged.bench.ask("INIT;*OPC?")
    logged.bench.instrument.trace_faults.arm(TraceFault.NAN)
    logged.bench.ask("TRAC? TRACE1")
    assert logged.bench.session.readings == (Reading(1, is_spoiled=True),)


def test_in_continuous_sweeping_each_trace_is_a_sweep_of_the_same_row(logged: Logged) -> None:
    logged.bench.ask("INIT:CONT ON")
    for _ in range(2):
        logged.bench.ask("TRAC? TRACE1")
    lines = logged.lines("sweep")
    assert [line["sweep"] for line in lines] == [1, 2]
    assert len({line["row"] for line in lines}) == 1


def test_an_aborted_sweep_is_no_line(logged: Logged) -> None:
    logged.bench.ask("ABOR")
    assert logged.lines("sweep") == []


def test_a_trace_of_a_forgotten_sweep_has_its_number_at_least(logged: Logged) -> None:
    logged.truth.trace(Reading(999, is_spoiled=False), "socket 1")
    assert logged.lines("trace") == [{"kind": "trace", "sweep": 999, "session": "socket 1", "spoiled": False}]


def test_interference_stands_apart(bench: Any) -> None:
    stream = io.StringIO()
    truth = TruthLog(stream, ("c1", "c2"), lambda: 0)
    emission = bench.source.current()
    names = ("c1", "interference c1", "c3")
    signals = tuple(
        type(signal)(name, signal.center_hz, signal.symbol_rate_hz, signal.rolloff, signal.power_dbm)
        for name, signal in zip(names, emission.signals, strict=True)
    )
    truth.sweep(1, type(emission)(emission.epoch_us, signals, emission.noise_dbm_hz), bench.instrument.settings)
    line = json.loads(stream.getvalue())
    assert line["power_dbm"] == {"c1": -40.0, "c2": None}
    assert line["interference_dbm"] == {"c1": -43.0}
