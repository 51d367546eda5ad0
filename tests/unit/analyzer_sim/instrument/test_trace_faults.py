"""Faults of what is shown: in every format, spent by traces alone, and never fatal to the instrument."""

from typing import Any

import numpy as np
import pytest

from analyzer_sim.instrument.levels import int32_block
from analyzer_sim.instrument.trace_faults import TraceFault, TraceFaults

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
