"""The R&S dialect: units, clock and status of a sweep; channel power of the trace shown."""

import math
from typing import Any

import numpy as np
import pytest

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 0.2;:DET RMS"
#: ten seconds in place of 0.2
SLOW = SETUP.replace("0.2", "10")
POWER = "CALC:MARK:FUNC:POW"


def test_frequencies_of_the_points_are_told(bench: Any) -> None:
    bench.ask(SETUP)
    axis_hz = np.array(bench.ask("TRAC:DATA:X? TRACE1").split(","), dtype=float)
    np.testing.assert_allclose(axis_hz, np.linspace(1007e6, 1027e6, 2001), rtol=1e-6)  # seven digits in text


def test_unit_moves_the_trace_and_keeps_it(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT")
    dbm = np.array(bench.ask("TRAC? TRACE1").split(","), dtype=float)
    shown = np.array(bench.ask("UNIT:POW DBUV;:TRAC? TRACE1").split(","), dtype=float)
    np.testing.assert_allclose(shown - dbm, 106.99, atol=0.01)  # rounded to 0.01 dB


def test_single_sweep_moves_the_clock_by_one_row(bench: Any) -> None:
    bench.ask(SETUP)
    assert bench.ask("INIT;*OPC?;:SIM:EPOCH?") == "1;2026-11-01T00:01:00.000000Z"
    assert bench.ask("SWE:COUN 10;:INIT;*OPC?;:SIM:EPOCH?") == "1;2026-11-01T00:02:00.000000Z"
    assert bench.ask("SYST:DATE?;TIME?") == "2026,11,1;0,2,0"


def test_overload_and_too_fast_sweep_are_questionable(bench: Any) -> None:
    bench.ask(SETUP + ";:STAT:QUES:ENAB 264;:INIT")
    assert bench.ask("STAT:QUES:COND?;EVEN?;:STAT:QUES?;:STAT:QUES:POW:COND?") == "0;0;0;0"
    assert bench.ask("*STB?") == "0"
    bench.ask("DISP:TRAC:Y:RLEV -70;:INIT")
    assert bench.ask("*STB?") == "8"
    assert bench.ask("STAT:QUES:COND?;POW:COND?") == "8;4"  # the intermediate frequency is overloaded, not the mixer
    assert max(float(value) for value in bench.ask("TRAC? TRACE1").split(",")) == -60.0
    bench.ask("DISP:TRAC:Y:RLEV 0;:SWE:TIME 0.01;:INIT")
    assert bench.ask("STAT:QUES:COND?") == "256"


def test_reset_keeps_the_error_queue_and_drops_the_trace(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT;NONE;*RST;:INIT:CONT OFF")
    assert bench.ask("TRAC? TRACE1") == ""
    assert bench.errors() == [-113, -230]


def test_channel_power_and_its_density(bench: Any) -> None:
    bench.ask(f"{SLOW};:INIT;:{POWER}:SEL CPOW;:POW:ACH:BWID 2.5 MHZ")
    power_dbm = float(bench.ask(f"{POWER}:RES? CPOW"))
    noise_mw = 10 ** ((-120 + 10 * math.log10(2.5e6)) / 10)
    # the carrier in the middle has -43 dBm; sigma 0.02 dB
    assert power_dbm == pytest.approx(10 * math.log10(10**-4.3 + noise_mw), abs=0.08)
    density = float(bench.ask(f"{POWER}:RES:PHZ ON;:{POWER}:RES? CPOW"))
    assert density == pytest.approx(power_dbm - 10 * math.log10(2.5e6), abs=1e-6)
    watts = float(bench.ask(f"UNIT:POW W;:{POWER}:RES:PHZ OFF;:{POWER}:RES? CPOW"))
    assert watts == pytest.approx(1e-3 * 10 ** (power_dbm / 10), rel=1e-6)
    assert bench.ask("FETC:CPOW:RES?") == bench.ask(f"{POWER}:RES? CPOW")
    assert bench.ask(f"POW:ACH:BWID 21 MHZ;:{POWER}:RES? CPOW") == "9.91E37"  # wider than the trace
    assert bench.errors() == []


def test_selecting_channel_power_makes_an_automatic_detector_rms(bench: Any) -> None:
    assert bench.ask(f"DET:AUTO ON;:{POWER}:SEL CPOW;:DET?;:{POWER}:SEL?;:{POWER}?") == "RMS;CPOW;1"
    assert bench.ask(f"{POWER} OFF;:{POWER}:SEL?;:{POWER}?;:DET POS;:{POWER}:SEL CPOW;:DET?") == "OFF;0;POS"


def test_channel_power_needs_a_trace_over_frequency(bench: Any) -> None:
    assert bench.ask(f"INIT:CONT OFF;:{POWER}:RES? CPOW") == ""
    assert bench.errors() == [-230]
    assert bench.ask(f"FREQ:SPAN 0;:INIT;:{POWER}:RES? CPOW") == ""
    assert bench.errors() == [-221]


def test_width_of_the_channel_has_limits_and_a_default(bench: Any) -> None:
    bench.ask("POW:ACH:BWID 1e12")
    assert bench.errors() == [-222]
    assert bench.ask("POW:ACH:BWID?;BWID? MIN;BWID? DEF;BWID MIN;BWID?;*RST;BWID?") == "1000000000;100;14000;100;14000"
