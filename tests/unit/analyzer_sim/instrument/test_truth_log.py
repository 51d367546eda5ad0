"""The truth of sweeps and traces as lines: what is true, what left, and nothing else."""

import io
import json
from typing import Any

import pytest

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.trace_faults import TraceFault
from analyzer_sim.instrument.truth_log import Reading, TruthLog
from analyzer_sim.lines.session import Session, command_tree
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World


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
