"""The R&S dialect: what each row sets, answers and couples; channel power of the trace shown."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analyzer_sim.dialects.rs import RS
from analyzer_sim.scpi.tree import parse_pattern

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 0.2;:DET RMS"
#: ten seconds in place of 0.2
SLOW = SETUP.replace("0.2", "10")
POWER = "CALC:MARK:FUNC:POW"
TRANSCRIPT = (
    ("*IDN?", "Rohde&Schwarz,FSW-26,1312.8000K26/100001,5.30"),
    ("*OPT?", "0"),
    ("*TST?", "0"),
    ("SYST:VERS?", "1999.0"),
    ("*ESR?", "128"),
    ("INIT:CONT?;:DET?;:DET:AUTO?;:UNIT:POW?;:FORM?", "1;APE;1;DBM;ASC,0"),
    ("INP:ATT?;ATT:AUTO?;:DISP:TRAC:Y:RLEV?", "10;1;0"),
    (":SENSe1:FREQuency:CENTer 1.017GHz", ""),
    ("FREQ:SPAN 20 MHZ;CENT?;SPAN?;STAR?;STOP?", "1017000000;20000000;1007000000;1027000000"),
    ("FREQ:CENT? MIN;CENT? MAX", "5;26499999995"),
    ("FREQ:CENT UP;CENT?;CENT DOWN;CENT?", "1019000000;1017000000"),
    ("BAND:RES:AUTO?;:BAND?;:BAND:VID?", "1;200000;200000"),
    ("BWID 30 kHz;:BAND?;:BAND:AUTO?;:BAND:VID?", "30000;0;30000"),
    ("BAND 31 KHZ;:BAND?", "30000"),
    ("BAND:VID 300 KHZ;:BAND:VID?;:BAND:VID:AUTO?", "300000;0"),
    ("SWE:TIME:AUTO?", "1"),
    ("SWE:TIME 200 MS;TIME?;DUR?;:SWE:TIME:AUTO?", "0.2;0.2;0"),
    ("SWE:WIND1:POIN 2401;POIN?", "2401"),
    ("SWE:POIN?;POIN? DEF", "2401;1001"),
    ("SWE:TYPE?;TYPE FFT;TYPE?;TYPE SWE", "AUTO;FFT"),
    ("SWE:COUN 5;COUN?", "5"),
    ("DET1:FUNC POSITIVE;:DET?;:DET:AUTO?", "POS;0"),
    ("SENS:WIND1:DET1:FUNC RMS;:DET?", "RMS"),
    ("AVER ON;:AVER:STAT1?;:DISP:WIND1:SUBW1:TRAC1:MODE?;:AVER:TYPE?", "1;AVER;VID"),
    ("DISP:TRAC:MODE WRIT;:AVER?", "0"),
    ("AVER:COUN 8;COUN?;TYPE POW;TYPE?", "8;POW"),
    ("DISP:WIND:TRAC:Y:SCAL:RLEV -30 DBM;RLEV?;:INP:ATT?", "-30;0"),
    ("INP:ATT 5 DB;ATT?;:INP:ATT:AUTO?", "5;0"),
    ("INP:GAIN:STAT ON;STAT?", "1"),
    ("CALC1:UNIT:POW DBUV;:UNIT:POW?", "DBUV"),
    ("FORM REAL;:FORM:DATA?", "REAL,32"),
    ("FORM ASC,0;:FORM?", "ASC,0"),
    ("INST?;:INST:LIST?;:INST:SEL SAN;:INST 'Spectrum'", "SAN;'SANALYZER','Spectrum'"),
    ("CORR:STAT?;:INP:IMP?;:TRIG:SOUR?;:TRIG:LEV?", "0;50;IMM;0"),
    ("SYST:DISP:UPD ON;UPD?;:SYST:LOC", "1"),
    ("SYST:DATE?;TIME?;:SIM:EPOCH?", "2026,11,1;0,0,0;2026-11-01T00:00:00.000000Z"),
    ("SYST:ERR:COUN?;:SYST:ERR?", '0;0,"No error"'),
    ("FREQ:SPAN 1e12;SPAN?", "26500000000"),
    ("SYST:ERR:ALL?", '-222,"Data out of range;1e+12"'),
    ("FREQ:OFFS 1 GHZ;STAR?;OFFS 0;STAR?", "1000000000;0"),
    ("SYST:PRES;:INIT:CONT?;:SWE:POIN?", "1;1001"),
)


def test_transcript_holds(bench: Any) -> None:
    for question, answer in TRANSCRIPT:
        assert bench.ask(question) == answer, question


def test_every_row_has_a_readable_pattern_and_a_handler() -> None:
    for row in RS.commands:
        assert parse_pattern(row.pattern), row.pattern
        assert row.write or row.query, row.pattern


def test_frequencies_of_the_points_are_told(bench: Any) -> None:
    bench.ask(SETUP)
    axis_hz = np.array(bench.ask("TRAC:DATA:X? TRACE1").split(","), dtype=float)
    np.testing.assert_allclose(axis_hz, np.linspace(1007e6, 1027e6, 2001), rtol=1e-6)  # seven digits in text


@pytest.mark.parametrize(
    ("unit", "offset"), [("DBM", 0.0), ("DBPW", 90.0), ("DBUV", 106.99), ("DBMV", 46.99), ("DBUA", 73.01)]
)
def test_unit_moves_the_trace_and_keeps_it(bench: Any, unit: str, offset: float) -> None:
    bench.ask(SETUP + ";:INIT")
    dbm = np.array(bench.ask("TRAC? TRACE1").split(","), dtype=float)
    shown = np.array(bench.ask(f"UNIT:POW {unit};:TRAC? TRACE1").split(","), dtype=float)
    np.testing.assert_allclose(shown - dbm, offset, atol=0.01)  # offsets above are rounded to 0.01 dB


def test_linear_units_follow_from_the_power_in_50_ohm(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT")
    dbm = np.array(bench.ask("TRAC? TRACE1").split(","), dtype=float)
    watts = 1e-3 * 10 ** (dbm / 10)
    for unit, expected in (("W", watts), ("V", np.sqrt(50 * watts)), ("A", np.sqrt(watts / 50))):
        shown = np.array(bench.ask(f"UNIT:POW {unit};:TRAC? TRACE1").split(","), dtype=float)
        np.testing.assert_allclose(shown, expected, rtol=1e-5)  # seven digits in text


def test_single_sweep_moves_the_clock_by_one_row(bench: Any) -> None:
    bench.ask(SETUP)
    assert bench.ask("INIT;*OPC?;:SIM:EPOCH?") == "1;2026-11-01T00:01:00.000000Z"
    assert bench.ask("SWE:COUN 10;:INIT;*OPC?;:SIM:EPOCH?") == "1;2026-11-01T00:02:00.000000Z"
    assert bench.ask("SYST:DATE?;TIME?") == "2026,11,1;0,2,0"


def test_continuous_sweep_is_fresh_and_leaves_the_clock(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT:CONT ON")
    first, second = bench.ask("TRAC? TRACE1"), bench.ask("TRAC? TRACE1")
    assert first != second
    assert bench.source.row == 0
    bench.ask("INIT")
    assert bench.errors() == [-213]


def test_overload_and_too_fast_sweep_are_questionable(make_bench: Callable[..., Any]) -> None:
    bench = make_bench()
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


def test_averaging_levels_in_decibels_reads_low_and_power_does_not(bench: Any) -> None:
    # sample detector: mean of dB of an exponential variable is 2.51 dB low (section 6 of the analyzer specification)
    bench.ask(SETUP + ";:DET SAMP;:BAND:VID 10 MHZ;:SWE:TIME 0.1;COUN 100;:AVER ON")
    means = {}
    for kind in ("VID", "POW"):
        bench.ask(f"AVER:TYPE {kind};:INIT")
        trace_dbm = np.array(bench.ask("TRAC? TRACE1").split(","), dtype=float)
        means[kind] = 10 * np.log10(np.mean(10 ** (trace_dbm[:200] / 10)))
    assert means["VID"] - means["POW"] == pytest.approx(-2.51, abs=0.15)  # 20000 samples, 5.6 dB each


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("TRAC?", -109),
        ("DET 5", -128),
        ("FORM REAL,64", -224),
        ("FORM INT,32", -141),
        ("FORM:BORD SWAP", -113),
        ("TRAC? TRACE7", -141),
        ("INST:SEL 'NOISE'", -224),
    ],
)
def test_wrong_unit_queues_its_error_and_answers_nothing(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]


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


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (f"{POWER}:RES?", -109),
        (f"{POWER}:RES? OBW", -141),
        (f"{POWER}:SEL ACP", -141),
        (f"{POWER}:SEL 5", -128),
        (f"{POWER} ON", -224),
        ("POW:ACH:BWID 1", -222),
        ("POW:ACH:BWID 1 S", -131),
        ("POW:ACH:BWID UP", -141),
        ("POW:ACH:BWID? 1", -128),
        ("POW:ACH:TXCH:COUN 2", -222),
        ("CALC1:MARK17:FUNC:POW:SEL?", -114),
    ],
)
def test_wrong_unit_of_channel_power_queues_its_error(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]
