"""Anritsu and Siglent: blocks and formats of traces, points, filter steps, the end of a sweep, channel power."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scpi_bench import block_payload

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 30 KHZ;:DISP:POIN 501;:SWE:TIME 0.2;:DET RMS"
# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
SLOW = "*RST;*CLS;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 30 KHZ;:DISP:POIN 2001;:SWE:TIME 10"
#: b and the noise of 3 MHz
B_DBM = 10 * math.log10(10**-4.3 + 10 ** ((-120 + 10 * math.log10(3e6)) / 10))


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    return make_bench(dialect="anritsu")


@pytest.fixture
def slow(bench: Any) -> Any:
    bench.ask(SLOW)
    return bench


def numbers(text: str) -> np.ndarray:
    return np.array(text.replace(";", ",").split(","), dtype=float)


def ascii_levels(bench: Any) -> np.ndarray:
    bench.ask("FORM ASC")
    return np.array(block_payload(bench.send(b"TRAC:DATA? 1\n")).split(b","), dtype=float)


def test_ascii_trace_stands_in_a_block(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    assert ascii_levels(bench).shape == (501,)


@pytest.mark.parametrize(
    ("form", "kind", "scale"), [("INT,32", "<i4", 1e-3), ("REAL,32", "<f4", 1.0), ("REAL,64", "<f8", 1.0)]
)
def test_blocks_are_little_endian_and_hold_the_ascii_trace(bench: Any, form: str, kind: str, scale: float) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    ascii_dbm = ascii_levels(bench)
    bench.ask(f"FORM {form}")
    values = scale * np.frombuffer(block_payload(bench.send(b"TRAC? 1\n")), kind)
    np.testing.assert_allclose(values, ascii_dbm, atol=6e-4)  # half a thousandth of a dB, seven digits of the text


def test_real_without_a_length_has_64_bits(bench: Any) -> None:
    assert bench.ask("FORM REAL;:FORM?") == "REAL,64"


@pytest.mark.parametrize("form", ["ASC", "INT,32", "REAL,32"])
def test_invalid_trace_is_marked(bench: Any, form: str) -> None:
    bench.ask(SETUP + f";:FORM {form}")
    assert bench.ask("TRAC? 1") == "#0"
    assert bench.ask("INIT;*WAI;:TRAC? 2") == "#0"
    assert bench.errors() == []


def test_preamble_describes_the_sweep(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    for query in ("TRAC:PRE?", "TRAC:PRE? 1", "TRACE:DATA:PREAMBLE? 1"):
        fields = dict(field.split(b"=", 1) for field in block_payload(bench.send(f"{query}\n".encode())).split(b","))
        assert fields[b"START_FREQ"] == b"1007.000000 MHZ"
        assert fields[b"STOP_FREQ"] == b"1027.000000 MHZ"
        assert fields[b"UI_DATA_POINTS"] == b"501"
        assert fields[b"RBW"] == b"0.030000 MHZ"
        assert fields[b"RBW_TYPE"] == b"MANUAL"
        assert fields[b"UNITS"] == b"DBM"


def test_points_are_those_of_the_display(bench: Any) -> None:
    assert bench.ask("DISP:POIN? MIN;POIN? MAX;POIN? DEF") == "10;20001;501"


def test_average_is_a_type_of_the_trace(bench: Any) -> None:
    assert bench.ask("AVER:TYPE?;COUN?") == "NONE;10"
    assert bench.ask("TRAC1:TYPE AVER;TYPE?;OPER?;:AVER:TYPE?") == "AVER;AVER;SCAL"
    assert bench.ask("AVER:TYPE NONE;:TRAC1:TYPE?") == "NORM"
    assert bench.ask("TRAC1:TYPE MAXH;:AVER:TYPE?") == "MAX"
    bench.instrument.settings.is_averaging = False  # as a measurement of single sweeps leaves it
    assert bench.ask("AVER:TYPE?;:TRAC1:TYPE?") == "NONE;NORM"


def test_configure_takes_rms_and_single_sweep_and_a_channel_as_wide_as_the_span(slow: Any) -> None:
    assert slow.ask("INIT:CONT?;:DET?;:CONF:CHP;:CONF?;:INIT:CONT?;:DET?;:CHP:BWID:INT?") == "1;POS;CHP;0;RMS;20000000"
    assert slow.ask("CHP:STAT?;STAT OFF;STAT?;:CONF?") == "1;0;SAN"


def test_channel_power_is_missing_until_there_is_a_sweep(slow: Any) -> None:
    assert slow.ask("CONF:CHP;:FETC:CHP?;:FETC:CHP:CHP?;:FETC:CHP:DENS?") == "-999.0,-999.0;-999.0;-999.0"
    assert slow.errors() == []


def test_channel_power_and_density(slow: Any) -> None:
    slow.ask("CONF:CHP;:CHP:BWID:INT 3 MHZ")
    power, density = numbers(slow.ask("READ:CHP?"))
    assert power == pytest.approx(B_DBM, abs=0.08)
    assert density == pytest.approx(power - 10 * math.log10(3e6), abs=1e-6)
    assert numbers(slow.ask("FETC:CHP?;:FETC:CHP:CHP?;:FETC:CHP:DENS?")).tolist() == [power, density, power, density]
    assert slow.source.row == 1
    assert slow.ask("CHP:BWID:INT 21 MHZ;:FETC:CHP:CHP?") == "-999.0"  # wider than the trace


def test_measure_takes_the_defaults_and_sweeps(slow: Any) -> None:
    slow.ask("CONF:CHP;:CHP:BWID:INT 3 MHZ")
    whole = numbers(slow.ask("MEAS:CHP?;:MEAS:CHP:CHP?;:MEAS:CHP:DENS?"))
    total_mw = 10**-4.0 + 10**-4.3 + 10**-4.6 + 20e6 * 1e-12
    assert whole[[0, 2]] == pytest.approx(10 * math.log10(total_mw), abs=0.1)
    assert (slow.source.row, slow.ask("CHP:BWID:INT?")) == (3, "20000000")


def test_read_is_started_once_and_held(slow: Any) -> None:
    slow.allow(False)
    slow.ask("CONF:CHP")
    assert slow.ask("READ:CHP?") == ""
    assert slow.go_on() == b""
    slow.allow(True)
    assert slow.go_on().count(b",") == 1
    assert (slow.source.row, slow.errors()) == (1, [])


def test_results_at_the_end_of_the_scenario_are_missing(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(dialect="anritsu", rows=0)
    bench.ask(SLOW + ";:CONF:CHP")
    assert bench.ask("READ:CHP?") == "-999.0,-999.0"
    assert bench.errors() == [-200]


SIGLENT_SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BWID 30 KHZ;:SWE:TIME 0.2;:DET:TRAC1 AVER"


@pytest.fixture
def siglent_bench(make_bench: Callable[..., Any]) -> Any:
    return make_bench(dialect="siglent")


@pytest.fixture
def swept(siglent_bench: Any) -> Any:
    """A sweep of 10 s that shows mean powers."""
    siglent_bench.ask(f"{SIGLENT_SETUP};:SWE:TIME 10;:AVER:TYPE POW;:INIT")
    return siglent_bench


@pytest.mark.parametrize("name", ["1", "TRC1", "TRACE1"])
def test_ascii_trace_ends_with_a_comma(siglent_bench: Any, name: str) -> None:
    siglent_bench.ask(SIGLENT_SETUP + ";:INIT;*WAI")
    fields = siglent_bench.ask(f"TRAC:DATA? {name}").split(",")
    assert len(fields) == 752
    assert fields[-1] == ""
    assert np.all(np.isfinite(np.array(fields[:-1], dtype=float)))


@pytest.mark.parametrize(("wanted", "step"), [("31 KHZ", 30e3), ("64 KHZ", 30e3), ("65 KHZ", 100e3), ("2 HZ", 3.0)])
def test_filter_takes_the_nearest_step_rounding_up(siglent_bench: Any, wanted: str, step: float) -> None:
    assert float(siglent_bench.ask(f"BWID {wanted};:BWID?;:BWID:VID {wanted}")) == step
    assert float(siglent_bench.ask("BWID:VID?")) == step


def test_sweep_time_has_the_limits_of_the_manual(siglent_bench: Any) -> None:
    assert siglent_bench.ask("SWE:TIME? MIN;TIME? MAX") == "0.000917;1000"


def test_end_of_a_sweep_can_be_polled(siglent_bench: Any) -> None:
    siglent_bench.allow(False)
    siglent_bench.ask("INIT:CONT OFF;:INIT")
    assert siglent_bench.ask("TRAC:SWE:STAT?;:TRAC:SWE:STAT? 1") == "0;0"
    siglent_bench.allow(True)
    assert siglent_bench.ask("TRAC:SWE:STAT?") == "1"


def test_default_is_the_positive_peak(siglent_bench: Any) -> None:
    assert siglent_bench.ask("DET:TRAC?;:AVER:TYPE?;:AVER:TRAC1:COUN?") == "POS;LOGP;100"


def test_filter_type_is_remembered(siglent_bench: Any) -> None:
    assert siglent_bench.ask("FILT:TYPE EMI;TYPE?;:FILT:TYPE GAUSS;:FILT:TYPE?") == "EMI;GAUSS"


def test_channel_power_and_density_of_siglent(swept: Any) -> None:
    assert swept.ask("CHP:BWID:INT?") == "2000000"
    values = numbers(swept.ask("CHP:BWID:INT 3 MHZ;:MEAS:CHP?;:MEAS:CHP:CHP?;:MEAS:CHP:DENS?"))
    assert values[0] == pytest.approx(B_DBM, abs=0.08)
    assert values[1] == pytest.approx(values[0] - 10 * math.log10(3e6), abs=1e-6)
    assert values[2:].tolist() == values[:2].tolist()
    assert swept.source.row == 1  # all from the trace there was


def test_channel_as_wide_as_the_span(swept: Any) -> None:
    whole = float(swept.ask("CHP:FREQ:SPAN:POW;:CHP:BWID:INT?;:MEAS:CHP:CHP?").split(";")[1])
    total_mw = 10**-4.0 + 10**-4.3 + 10**-4.6 + 20e6 * 1e-12
    assert whole == pytest.approx(10 * math.log10(total_mw), abs=0.1)


def test_channel_power_sweeps_only_when_the_settings_have_changed(swept: Any) -> None:
    swept.ask("MEAS:CHP?;:MEAS:CHP:DENS?")
    assert swept.source.row == 1
    swept.ask("FREQ:SPAN 10 MHZ;:MEAS:CHP?;:MEAS:CHP?")
    assert swept.source.row == 2
    swept.ask("INIT:CONT ON;:MEAS:CHP?;:MEAS:CHP?")
    assert (swept.source.row, swept.errors()) == (2, [])


def test_channel_power_waits_until_its_row_is_allowed(siglent_bench: Any) -> None:
    siglent_bench.allow(False)
    siglent_bench.ask("*RST;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ")
    assert siglent_bench.ask("MEAS:CHP:CHP?") == ""
    siglent_bench.allow(True)
    assert float(siglent_bench.go_on()) < 0.0


def test_measurement_on_the_screen(siglent_bench: Any) -> None:
    assert siglent_bench.ask("INST:MEAS?;MEAS CHP;MEAS?;MEAS OFF;MEAS?") == "OFF;CHP;OFF"
