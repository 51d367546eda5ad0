"""Keysight: formats and byte orders, presets, detectors that follow the average type, Swept SA and channel power."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scpi_bench import block_payload

SETUP = "*RST;*CLS;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BAND 30 KHZ;:SWE:POIN 2001;TIME 0.2;:DET:TRAC AVER;:AVER:TYPE RMS"
# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
#: b and the noise of 3 MHz
B_DBM = 10 * math.log10(10**-4.3 + 10 ** ((-120 + 10 * math.log10(3e6)) / 10))


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    return make_bench(dialect="keysight")


@pytest.fixture
def tuned(bench: Any) -> Any:
    bench.ask("*RST;*CLS;:FREQ:CENT 1017 MHZ")
    return bench


def numbers(text: str) -> np.ndarray:
    return np.array(text.split(","), dtype=float)


@pytest.mark.parametrize(
    ("form", "order", "kind", "scale"),
    [
        ("REAL,32", "NORM", ">f4", 1.0),
        ("REAL,32", "SWAP", "<f4", 1.0),
        ("REAL,64", "NORM", ">f8", 1.0),
        ("REAL,64", "SWAP", "<f8", 1.0),
        ("INT,32", "NORM", ">i4", 1e-3),
        ("INT,32", "SWAP", "<i4", 1e-3),
    ],
)
def test_blocks_hold_the_ascii_trace(bench: Any, form: str, order: str, kind: str, scale: float) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    ascii_dbm = numbers(bench.ask("TRAC? TRACE1"))
    assert ascii_dbm.shape == (2001,)
    bench.ask(f"FORM {form};:FORM:BORD {order}")
    levels = np.frombuffer(block_payload(bench.send(b"TRAC:DATA? TRACE1\n")), kind)
    # seven digits of the text, and half a step of the integers
    np.testing.assert_allclose(scale * levels, ascii_dbm, atol=max(1e-4, 0.51 * scale % 1))
    assert bench.errors() == []


def test_blocks_are_big_endian_after_reset(bench: Any) -> None:
    bench.ask("FORM:BORD SWAP;*RST")
    assert bench.ask("FORM:BORD?") == "NORM"


def test_pairs_of_frequency_and_level(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT;*WAI;:FREQ:OFFS 1 GHZ")
    bench.ask("INIT;*WAI")
    levels = numbers(bench.ask("TRAC? TRACE1"))
    for query in ("FETC:SAN?", "FETC:SAN1?", "CALC:DATA?", "CALC:DATA1?"):
        pairs = numbers(bench.ask(query)).reshape(-1, 2)
        np.testing.assert_allclose(pairs[:, 0], np.linspace(2007e6, 2027e6, 2001), rtol=1e-6)  # seven digits
        np.testing.assert_array_equal(pairs[:, 1], levels)


def test_read_takes_a_new_sweep_and_fetch_does_not(bench: Any) -> None:
    bench.ask(SETUP)
    assert bench.ask("FETC:SAN?") == ""
    assert bench.errors() == [-230]
    first = bench.ask("READ:SAN?")
    assert bench.source.row == 1
    assert bench.ask("FETC:SAN?") == first
    assert bench.ask("READ:SAN?") != first
    assert bench.source.row == 2


def test_other_traces_are_blank(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    for query in ("FETC:SAN2?", "CALC:DATA2?", "TRAC? TRACE2"):
        assert bench.ask(query) == ""
    assert bench.errors() == [-230, -230, -230]


def test_pairs_of_zero_span_are_of_time_and_level(bench: Any) -> None:
    bench.ask(SETUP + ";:FREQ:SPAN 0;:INIT;*WAI")
    pairs = numbers(bench.ask("FETC:SAN?")).reshape(-1, 2)
    np.testing.assert_allclose(pairs[:, 0], np.linspace(0.0, 0.2, 2001), rtol=1e-6)  # seven digits


def test_configure_and_measure_return_to_defaults_and_ndefault_does_not(bench: Any) -> None:
    bench.ask(SETUP + ";:FORM REAL,64;:FORM:BORD SWAP;:CONF:SAN:NDEF")
    assert bench.ask("SWE:POIN?;:CONF?") == "2001;SAN"
    bench.ask("CONF:SAN")
    assert bench.ask("SWE:POIN?;:DET:TRAC?;:BAND:AUTO?;:FORM?;:FORM:BORD?;:INIT:CONT?") == "1001;NORM;1;REAL,64;SWAP;0"
    bench.ask(SETUP)
    assert bench.ask("MEAS:SAN?").count(",") == 2 * 1001 - 1


def test_read_waits_for_its_sweep(bench: Any) -> None:
    bench.ask(SETUP)
    bench.allow(False)
    assert bench.ask("READ:SAN?") == ""
    assert bench.session.is_held
    bench.allow(True)
    assert bench.go_on().count(b",") == 4001
    assert bench.source.row == 1


def test_other_detectors_do_not_follow_the_average_type(bench: Any) -> None:
    assert bench.ask("DET:TRAC POS;:AVER:TYPE RMS;:DET:TRAC?;:DET:AUTO?") == "POS;0"
    assert bench.ask("DET:AUTO ON;:DET?;:DET:TRAC?") == "NORM;NORM"


def test_average_type_is_automatic_until_it_is_chosen(bench: Any) -> None:
    assert bench.ask("AVER:TYPE?;TYPE:AUTO?") == "LOG;1"
    bench.ask("AVER:TYPE RMS")
    assert bench.ask("AVER:TYPE:AUTO?") == "0"
    bench.ask("AVER:TYPE:AUTO ON")
    assert bench.ask("AVER:TYPE?") == "LOG"


def test_sweep_type_is_automatic_until_it_is_chosen(bench: Any) -> None:
    assert bench.ask("SWE:TYPE?;TYPE:AUTO?") == "SWE;1"
    bench.ask("SWE:TYPE FFT")
    assert bench.ask("SWE:TYPE?;TYPE:AUTO?") == "FFT;0"
    bench.ask("SWE:TYPE:AUTO ON")
    assert bench.ask("SWE:TYPE?;TYPE:AUTO?") == "SWE;1"


def test_averages_of_a_trace_are_one_measurement(bench: Any) -> None:
    bench.ask(SETUP + ";:AVER:COUN 20;:TRAC1:TYPE AVER;:INIT;*WAI")
    averaged = numbers(bench.ask("TRAC? TRACE1"))[:200].std()
    bench.ask("TRAC1:TYPE WRIT;:INIT;*WAI")
    single = numbers(bench.ask("TRAC? TRACE1"))[:200].std()
    assert averaged < 0.4 * single
    assert bench.source.row == 2


def test_holds_keep_the_highest_and_the_lowest_of_the_sweeps(bench: Any) -> None:
    bench.ask(SETUP + ";:AVER:COUN 50")
    means = {}
    for mode in ("AVER", "MAXH", "MINH"):
        bench.ask(f"TRAC1:TYPE {mode};:INIT;*WAI")
        means[mode] = numbers(bench.ask("TRAC? TRACE1"))[:200].mean()
    # highest and lowest of 50 values with a deviation of 4.343 / sqrt(4.9) dB stand some 2.2 deviations off
    assert 3.0 < means["MAXH"] - means["AVER"] < 5.0
    assert 4.0 < means["AVER"] - means["MINH"] < 8.0


def test_drivers_find_options_modes_and_measurements(bench: Any) -> None:
    options = bench.ask("*OPT?")[1:-1].split(",")
    modes = [mode.strip().split(" ")[0] for mode in bench.ask("INST:CAT?")[1:-1].split(",")]
    measurements = [name.strip() for name in bench.ask("CONF:CAT?")[1:-1].split(",")]
    assert "526" in options
    assert modes == ["SA"]
    assert measurements[0] == "SAN"
    assert bench.ask("CONF:SAN:NDEF;:CONF?") == "SAN"


def test_filter_takes_the_steps_of_the_e24_series(bench: Any) -> None:
    assert bench.ask("BAND 31 KHZ;:BAND?;:BAND 6.5 MHZ;:BAND?;:BAND:VID 40 MHZ;VID?") == "30000;6000000;50000000"


@pytest.mark.parametrize(("kind", "step_db"), [("DB3", 0.0), ("DB6", -1.505), ("NOIS", -0.272), ("IMP", -1.777)])
def test_filter_type_tells_which_width_is_set(bench: Any, kind: str, step_db: float) -> None:
    # a Gaussian filter as wide as before by another of its widths is narrower at 3 dB: 10 lg of 1/1.414 1/1.064 1/1.505
    bench.ask(SETUP + ";:SWE:TIME 100;:INIT;*WAI")
    reference = numbers(bench.ask("TRAC? TRACE1"))[:200].mean()
    bench.ask(f"BAND:TYPE {kind};:INIT;*WAI")
    assert bench.ask("BAND?;:BAND:TYPE?") == f"30000;{kind}"
    assert numbers(bench.ask("TRAC? TRACE1"))[:200].mean() - reference == pytest.approx(step_db, abs=0.03)


def test_level_offset_moves_trace_and_reference(bench: Any) -> None:
    bench.ask(SETUP + ";:SWE:TIME 100;:DISP:WIND:TRAC:Y:RLEV -20;:INIT;*WAI")
    reference = numbers(bench.ask("TRAC? TRACE1")).mean()
    bench.ask("DISP:WIND:TRAC:Y:RLEV:OFFS 10;:INIT;*WAI")
    assert bench.ask("DISP:WIND:TRAC:Y:RLEV?;RLEV? MAX;:POW:ATT?") == "-10;40;0"
    assert numbers(bench.ask("TRAC? TRACE1")).mean() - reference == pytest.approx(10.0, abs=0.02)
    bench.ask("DISP:WIND:TRAC:Y:RLEV 10")
    assert bench.ask("POW:ATT?") == "10"


def test_too_fast_sweep_is_a_matter_of_integrity(bench: Any) -> None:
    bench.ask(SETUP + ";:STAT:QUES:ENAB 512;:INIT;*WAI")
    assert bench.ask("STAT:QUES:COND?;INT:COND?") == "0;0"
    bench.ask("SWE:TIME 0.01;:INIT;*WAI")
    assert bench.ask("STAT:QUES:COND?;INT:COND?") == "512;8"
    assert bench.ask("*STB?") == "8"


def test_channel_power_sweeps_on_its_own_and_answers_power_and_density(tuned: Any) -> None:
    assert tuned.ask("CONF?;:CONF:CHP;:CONF?") == "SAN;CHP"
    tuned.ask("CHP:BAND:INT 3 MHZ;:CHP:FREQ:SPAN 6 MHZ;:CHP:SWE:TIME 1")
    power, density = numbers(tuned.ask("READ:CHP?"))
    assert power == pytest.approx(B_DBM, abs=0.05)  # ten sweeps of a second: 0.01 dB
    assert density == pytest.approx(power - 10 * math.log10(3e6), abs=1e-6)
    again = tuned.ask("FETC:CHP?;:FETC:CHP:CHP?;:FETC:CHP1:DENS?").replace(";", ",")
    assert numbers(again).tolist() == [power, density, power, density]
    assert tuned.source.row == 1
    assert tuned.ask("FREQ:SPAN?") == "2034000000"  # the span of the spectrum is its own: all about that centre
    assert tuned.errors() == []


def test_configure_forgets_the_settings_of_channel_power_and_ndefault_keeps_them(tuned: Any) -> None:
    tuned.ask("CONF:CHP;:CHP:BAND:INT 3 MHZ;:CHP:FREQ:SPAN 6 MHZ;:CHP:AVER:COUN 3;:CHP:BAND 100 KHZ")
    tuned.ask("CONF:SAN;:CONF:CHP:NDEF")
    asked = ":CHP:BAND:INT?;:CHP:FREQ:SPAN?;:CHP:AVER:COUN?;:CHP:BAND?;:CHP:BAND:AUTO?"
    assert tuned.ask(asked) == "3000000;6000000;3;100000;0"
    tuned.ask("INIT:CHP;*WAI;:FETC:CHP?")
    assert tuned.ask(asked) == "3000000;6000000;3;100000;0"
    tuned.ask("MEAS:CHP?")
    assert tuned.ask(asked).startswith("2000000;3000000;10;")
    assert tuned.ask("CHP:BAND:AUTO?") == "1"
    tuned.ask("CHP:BAND:INT 3 MHZ;:CONF:CHP")
    assert tuned.ask("CHP:BAND:INT?") == "2000000"
    assert tuned.errors() == []


def test_fetch_of_channel_power_needs_its_selection_and_a_sweep(tuned: Any) -> None:
    assert tuned.ask("FETC:CHP?") == ""
    assert tuned.errors() == [-221]
    tuned.ask("CONF:CHP")
    assert tuned.ask("FETC:CHP?") == ""
    assert tuned.errors() == [-230]
    tuned.ask("READ:CHP?;:CHP:AVER:COUN 5")  # a setting that shapes the sweep
    assert tuned.ask("FETC:CHP?") == ""
    assert tuned.errors() == [-230]


def test_averages_of_channel_power_are_of_power_and_can_be_switched_off(tuned: Any) -> None:
    tuned.ask("CONF:CHP;:CHP:BAND:INT 3 MHZ;:CHP:FREQ:SPAN 6 MHZ")
    ten = [float(tuned.ask("READ:CHP:CHP?")) for _ in range(40)]
    assert tuned.ask("CHP:AVER?;AVER OFF;AVER?;AVER:COUN?") == "1;0;10"
    one = [float(tuned.ask("READ:CHP:CHP?")) for _ in range(40)]
    assert np.std(one) / np.std(ten) == pytest.approx(math.sqrt(10), rel=0.4)  # each deviation to 11 %


def test_second_result_of_channel_power_is_the_trace(tuned: Any) -> None:
    tuned.ask("CONF:CHP;:READ:CHP?")
    assert tuned.ask("FETC:CHP2?") == tuned.ask("TRAC? TRACE1")
    assert tuned.ask("FETC:CHP3?") == ""
    assert tuned.errors() == [-114]


def test_read_of_channel_power_is_started_once_and_held(tuned: Any) -> None:
    for verb in ("READ", "MEAS"):
        tuned.allow(False)
        assert tuned.ask(f"{verb}:CHP?;*ESE?") == ""
        assert tuned.session.is_held
        assert tuned.go_on() == b""
        tuned.allow(True)
        assert tuned.go_on().count(b",") == 1
    assert (tuned.source.row, tuned.errors()) == (2, [])


def test_read_waits_for_the_sweep_of_another_client(tuned: Any) -> None:
    tuned.allow(False)
    tuned.ask("CONF:CHP;:INIT")
    assert tuned.ask("READ:CHP?") == ""
    tuned.allow(True)
    assert tuned.go_on().count(b",") == 1
    assert (tuned.source.row, tuned.errors()) == (2, [])


def test_read_in_continuous_sweep_answers_and_leaves_the_clock(tuned: Any) -> None:
    tuned.ask("INIT:CONT ON;:CONF:CHP")
    assert tuned.ask("READ:CHP?") != tuned.ask("READ:CHP?")
    assert (tuned.source.row, tuned.errors()) == (0, [])


def test_reset_returns_to_the_spectrum(tuned: Any) -> None:
    tuned.ask("CONF:CHP;:CHP:BAND:INT 5 MHZ;*RST")
    assert tuned.ask("CONF?;:CHP:BAND:INT?") == "SAN;2000000"
