"""Anritsu measurement functions: verbs, -999.0, markers."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analyzer_sim.dialects.makers.anritsu import ANRITSU

# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
SETUP = "*RST;*CLS;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 30 KHZ;:DISP:POIN 2001;:SWE:TIME 10"
#: b and the noise of 3 MHz
B_DBM = 10 * math.log10(10**-4.3 + 10 ** ((-120 + 10 * math.log10(3e6)) / 10))


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    made = make_bench(dialect=ANRITSU)
    made.ask(SETUP)
    return made


def numbers(text: str) -> np.ndarray:
    return np.array(text.replace(";", ",").split(","), dtype=float)


def test_configure_takes_rms_and_single_sweep_and_a_channel_as_wide_as_the_span(bench: Any) -> None:
    assert bench.ask("INIT:CONT?;:DET?;:CONF:CHP;:CONF?;:INIT:CONT?;:DET?;:CHP:BWID:INT?") == "1;POS;CHP;0;RMS;20000000"
    assert bench.ask("CHP:STAT?;STAT OFF;STAT?;:CONF?") == "1;0;SAN"


def test_results_are_missing_until_there_is_a_sweep(bench: Any) -> None:
    bench.ask("CONF:CHP")
    assert bench.ask("FETC:CHP?;:FETC:CHP:CHP?;:FETC:OBW?;:FETC:OBW:FREQ?;:FETC:PEAK?;:FETC:ACP?") == ";".join(
        ["-999.0,-999.0", "-999.0", "-999.0,-999.0,-999.0", "-999.0,-999.0", "-999.0,-999.0", ",".join(["-999.0"] * 5)]
    )
    assert bench.errors() == []


def test_channel_power_and_density(bench: Any) -> None:
    bench.ask("CONF:CHP;:CHP:BWID:INT 3 MHZ")
    power, density = numbers(bench.ask("READ:CHP?"))
    assert power == pytest.approx(B_DBM, abs=0.08)
    assert density == pytest.approx(power - 10 * math.log10(3e6), abs=1e-6)
    assert numbers(bench.ask("FETC:CHP?;:FETC:CHP:CHP?;:FETC:CHP:DENS?")).tolist() == [power, density, power, density]
    assert bench.source.row == 1
    assert bench.ask("CHP:BWID:INT 21 MHZ;:FETC:CHP:CHP?") == "-999.0"  # wider than the trace


def test_measure_takes_the_defaults_and_sweeps(bench: Any) -> None:
    bench.ask("CONF:CHP;:CHP:BWID:INT 3 MHZ")
    whole = numbers(bench.ask("MEAS:CHP?;:MEAS:CHP:CHP?;:MEAS:CHP:DENS?"))
    total_mw = 10**-4.0 + 10**-4.3 + 10**-4.6 + 20e6 * 1e-12
    assert whole[[0, 2]] == pytest.approx(10 * math.log10(total_mw), abs=0.1)
    assert (bench.source.row, bench.ask("CHP:BWID:INT?")) == (3, "20000000")


def test_occupied_bandwidth_sets_one_of_percent_and_decibels_and_measures_the_other(bench: Any) -> None:
    bench.ask("CHP:FREQ:SPAN 6 MHZ;:CONF:OBW;:OBW:PERC 90;:INIT;*WAI")
    width, percent, down_db = numbers(bench.ask("FETC:OBW?"))
    low_hz, high_hz = numbers(bench.ask("FETC:OBW:FREQ?"))
    assert (width, percent) == (pytest.approx(2.0e6, abs=0.1e6), 90.0)
    assert high_hz - low_hz == pytest.approx(width, rel=1e-6)
    by_level = numbers(bench.ask(f"OBW:METH XDB;XDB {down_db};:FETC:OBW?"))
    assert by_level[1] == pytest.approx(90.0, abs=2.0)
    assert by_level[2] == pytest.approx(down_db, rel=1e-9)


def test_neighbours(bench: Any) -> None:
    bench.ask("CONF:ACP;:ACP:BAND:MAIN 3 MHZ;ADJ 1.5 MHZ;:ACP:SPAC 5 MHZ;:INIT;*WAI")
    values = numbers(bench.ask("FETC:ACP?"))
    assert values[:3] == pytest.approx([B_DBM, -40.0, -45.8], abs=0.2)
    assert values[3:].tolist() == [-999.0, -999.0]  # the alternate pair lies outside the trace


def test_peak_and_markers(bench: Any) -> None:
    bench.ask("CONF:CHP;:INIT;*WAI")
    frequency_hz, level_dbm = numbers(bench.ask("FETC:PEAK?"))
    bench.ask("CALC:MARK1:MAX")
    assert numbers(bench.ask("CALC:MARK1:X?;Y?")) == pytest.approx([frequency_hz, level_dbm])
    bench.ask("CALC:MARK1:PEAK:EXC 10")
    bench.ask("CALC:MARK1:MAX:RIGH")
    assert float(bench.ask("CALC:MARK1:X?")) == pytest.approx(1022e6, abs=0.3e6)
    bench.ask("CALC:MARK1:MAX:RIGH")
    assert bench.ask("CALC:MARK1:X?") == "1027000000"  # no further peak: the end of the trace
    bench.ask("CALC:MARK2:X 1008.5 MHZ;:CALC:MARK2:NOIS ON")
    assert float(bench.ask("CALC:MARK2:Y?")) == pytest.approx(-120.0, abs=0.3)
    assert bench.ask("CALC:MARK2:NOIS?;:CALC:MARK:PEAK:THR?") == "1;10"


def test_read_is_started_once_and_held(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect=ANRITSU)
    bench.ask(SETUP + ";:CONF:CHP")
    assert bench.ask("READ:CHP?") == ""
    assert bench.go_on() == b""
    allowed.append(True)
    bench.instrument.complete_pending()
    assert bench.go_on().count(b",") == 1
    assert (bench.source.row, bench.errors()) == (1, [])


def test_results_at_the_end_of_the_scenario_are_missing(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(dialect=ANRITSU, rows=0)
    bench.ask(SETUP + ";:CONF:CHP")
    assert bench.ask("READ:CHP?") == "-999.0,-999.0"
    assert bench.errors() == [-200]


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("CHP:BWID:INT 99 GHZ", -222),
        ("CHP:BWID:INT 1 S", -131),
        ("OBW:PERC 101", -222),
        ("OBW:METH DBC", -141),
        ("CONF:XYZ", -113),
        ("FETC:CHP", -113),
        ("FETC:CHP3?", -114),
        ("CALC:MARK13:X?", -114),
        ("CALC:MARK1:Y?", -221),
        ("CALC:MARK1:NOIS MAYBE", -141),
    ],
)
def test_wrong_unit_queues_its_error_and_answers_nothing(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]
