"""Keysight measurement functions: verbs, sweeps of their own, marker functions, wrong parameters."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analyzer_sim.dialects.makers.keysight import KEYSIGHT

# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
SPECTRUM = "*RST;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 30 KHZ;:SWE:POIN 2001;TIME 10;:DET:TRAC AVER;:AVER:TYPE RMS"
#: b and the noise of 3 MHz
B_DBM = 10 * math.log10(10**-4.3 + 10 ** ((-120 + 10 * math.log10(3e6)) / 10))


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    made = make_bench(dialect=KEYSIGHT)
    made.ask("*RST;*CLS;:FREQ:CENT 1017 MHZ")
    return made


def numbers(text: str) -> np.ndarray:
    return np.array(text.split(","), dtype=float)


def test_channel_power_sweeps_on_its_own_and_answers_power_and_density(bench: Any) -> None:
    assert bench.ask("CONF?;:CONF:CHP;:CONF?") == "SAN;CHP"
    bench.ask("CHP:BAND:INT 3 MHZ;:CHP:FREQ:SPAN 6 MHZ;:CHP:SWE:TIME 1")
    power, density = numbers(bench.ask("READ:CHP?"))
    assert power == pytest.approx(B_DBM, abs=0.05)  # ten sweeps of a second: 0.01 dB
    assert density == pytest.approx(power - 10 * math.log10(3e6), abs=1e-6)
    again = bench.ask("FETC:CHP?;:FETC:CHP:CHP?;:FETC:CHP1:DENS?").replace(";", ",")
    assert numbers(again).tolist() == [power, density, power, density]
    assert bench.source.row == 1
    assert bench.ask("FREQ:SPAN?") == "2034000000"  # the span of the spectrum is its own: all about that centre
    assert bench.errors() == []


def test_configure_and_measure_forget_settings_and_not_default_keeps_them(bench: Any) -> None:
    bench.ask("CONF:CHP;:CHP:BAND:INT 3 MHZ;:CHP:FREQ:SPAN 6 MHZ;:CHP:AVER:COUN 3;:CHP:BAND 100 KHZ")
    bench.ask("CONF:SAN;:CONF:CHP:NDEF")
    asked = ":CHP:BAND:INT?;:CHP:FREQ:SPAN?;:CHP:AVER:COUN?;:CHP:BAND?;:CHP:BAND:AUTO?"
    assert bench.ask(asked) == "3000000;6000000;3;100000;0"
    bench.ask("INIT:CHP;*WAI;:FETC:CHP?")
    assert bench.ask(asked) == "3000000;6000000;3;100000;0"
    bench.ask("MEAS:CHP?")
    assert bench.ask(asked).startswith("2000000;3000000;10;")
    assert bench.ask("CHP:BAND:AUTO?") == "1"
    bench.ask("CHP:BAND:INT 3 MHZ;:CONF:CHP")
    assert bench.ask("CHP:BAND:INT?") == "2000000"
    assert bench.errors() == []


def test_fetch_needs_the_measurement_and_a_sweep(bench: Any) -> None:
    assert bench.ask("FETC:CHP?") == ""
    assert bench.errors() == [-221]
    bench.ask("CONF:CHP")
    assert bench.ask("FETC:CHP?") == ""
    assert bench.errors() == [-230]
    bench.ask("READ:CHP?;:CHP:AVER:COUN 5")  # a setting that shapes the sweep
    assert bench.ask("FETC:CHP?") == ""
    assert bench.errors() == [-230]


def test_averages_are_of_power_and_can_be_switched_off(bench: Any) -> None:
    bench.ask("CONF:CHP;:CHP:BAND:INT 3 MHZ;:CHP:FREQ:SPAN 6 MHZ")
    ten = [float(bench.ask("READ:CHP:CHP?")) for _ in range(40)]
    assert bench.ask("CHP:AVER?;AVER OFF;AVER?;AVER:COUN?") == "1;0;10"
    one = [float(bench.ask("READ:CHP:CHP?")) for _ in range(40)]
    assert np.std(one) / np.std(ten) == pytest.approx(math.sqrt(10), rel=0.4)  # each deviation to 11 %


def test_second_result_is_the_trace(bench: Any) -> None:
    bench.ask("CONF:CHP;:READ:CHP?")
    assert bench.ask("FETC:CHP2?") == bench.ask("TRAC? TRACE1")
    assert bench.ask("FETC:CHP3?") == ""
    assert bench.errors() == [-114]


def test_occupied_bandwidth_answers_seven_values(bench: Any) -> None:
    bench.ask("CONF:OBW;:OBW:PERC 90;XDB -3.0103;:OBW:FREQ:SPAN 6 MHZ;:OBW:BAND 10 KHZ;:OBW:SWE:TIME 10;AUTO?")
    width, power, span, points, rbw, error, down = numbers(bench.ask("READ:OBW?"))
    assert width == pytest.approx(2.0e6, abs=0.1e6)
    assert power == pytest.approx(10 * math.log10(10**-4.3 + 6e6 * 1e-12), abs=0.05)
    assert (span, points, rbw) == (6e6, 1001, 10e3)
    assert abs(error) < 20e3
    assert down == pytest.approx(2e6, rel=0.05)
    again = bench.ask("FETC:OBW:OBW?;:FETC:OBW:FERR?;:FETC:OBW:XDB?").replace(";", ",")
    assert numbers(again).tolist() == [width, error, down]
    assert bench.ask("OBW:XDB -60;:FETC:OBW:XDB?") == "9.91E37"  # the trace does not fall so far


def test_neighbours_come_relative_and_absolute(bench: Any) -> None:
    bench.ask(
        "CONF:ACP;:ACP:FREQ:SPAN 20 MHZ;:ACP:CARR:LIST:BAND 3 MHZ;:ACP:OFFS:LIST 5 MHZ;:ACP:OFFS:LIST:BAND 1.5 MHZ"
    )
    values = numbers(bench.ask("ACP:SWE:TIME 1;:READ:ACP?"))
    assert values[:6] == pytest.approx([0.0, B_DBM, 2.8, -40.0, -2.9, -45.8], abs=0.3)
    assert (len(values), values[6:].tolist()) == (26, [9.91e37] * 20)
    assert bench.ask("ACP:OFFS:LIST?") == "5000000,0,0,0,0,0"


def test_read_is_started_once_and_held_until_its_row_is_allowed(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect=KEYSIGHT)
    bench.ask("*RST;:FREQ:CENT 1017 MHZ")
    for verb in ("READ", "MEAS"):
        assert bench.ask(f"{verb}:CHP?;*ESE?") == ""
        assert bench.session.is_held
        assert bench.go_on() == b""
        allowed.append(True)
        bench.instrument.complete_pending()
        assert bench.go_on().count(b",") == 1
        allowed.clear()
    assert (bench.source.row, bench.errors()) == (2, [])


def test_read_waits_for_the_sweep_of_another_client(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect=KEYSIGHT)
    bench.ask("*RST;:FREQ:CENT 1017 MHZ;:CONF:CHP;:INIT")
    assert bench.ask("READ:CHP?") == ""
    allowed.append(True)
    bench.instrument.complete_pending()
    assert bench.go_on().count(b",") == 1
    assert (bench.source.row, bench.errors()) == (2, [])


def test_read_in_continuous_sweep_answers_and_leaves_the_clock(bench: Any) -> None:
    bench.ask("INIT:CONT ON;:CONF:CHP")
    assert bench.ask("READ:CHP?") != bench.ask("READ:CHP?")
    assert (bench.source.row, bench.errors()) == (0, [])


def test_marker_functions(bench: Any) -> None:
    bench.ask(SPECTRUM + ";:INIT;*WAI")
    assert bench.ask("CALC:MARK1:Y?;X?;STAT?") == "9.91E37;9.91E37;0"
    bench.ask("CALC:MARK1:MODE POS;X 1017 MHZ")
    level = float(bench.ask("CALC:MARK1:Y?"))
    assert level == pytest.approx(-43.0 - 10 * math.log10(2e6 / 31.93e3), abs=1.5)
    bench.ask("CALC:MARK1:FUNC BPOW;FUNC:BAND:SPAN 3 MHZ")
    power = float(bench.ask("CALC:MARK1:Y?"))
    assert power == pytest.approx(B_DBM, abs=0.08)
    assert float(bench.ask("CALC:MARK1:FUNC BDEN;:CALC:MARK1:Y?")) == pytest.approx(power - 64.771, abs=1e-3)
    bench.ask("CALC:MARK2:X 1008.5 MHZ;FUNC NOIS")
    assert float(bench.ask("CALC:MARK2:Y?")) == pytest.approx(-120.0, abs=0.3)
    assert bench.ask("CALC:MARK2:FUNC?;FUNC OFF;FUNC?;MODE?;MODE OFF;STAT?;MODE?") == "NOIS;OFF;POS;0;OFF"
    assert bench.ask("CALC:MARK1:FUNC:BAND:SPAN 25 MHZ;:CALC:MARK1:Y?") == "9.91E37"  # wider than the trace
    assert bench.errors() == []


def test_search_goes_to_the_nearest_peak(bench: Any) -> None:
    bench.ask(SPECTRUM + ";:INIT;*WAI;:CALC:MARK:PEAK:EXC 10;:CALC:MARK1:MAX")
    for center_hz in (1017e6, 1022e6):
        bench.ask("CALC:MARK1:MAX:RIGH")
        assert float(bench.ask("CALC:MARK1:X?")) == pytest.approx(center_hz, abs=1.1e6)


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("CHP:BAND:INT 1", -222),
        ("CHP:BAND:INT 1 S", -131),
        ("CHP:BAND 99 GHZ", -222),
        ("CHP:BAND:AUTO 'x'", -158),
        ("CHP:BAND UP", -141),
        ("CHP:SWE:TIME 1 HZ", -131),
        ("CHP:AVER:COUN 0", -222),
        ("OBW:PERC 5", -222),
        ("OBW:PERC 99 DB", -131),
        ("OBW:XDB 3", -222),
        ("ACP:OFFS:LIST 1,2,3,4,5,6,7", -108),
        ("ACP:OFFS:LIST MAX", -141),
        ("ACP:OFFS:LIST -1", -222),
        ("CALC:MARK13:X?", -114),
        ("CALC:MARK:FUNC FOO", -141),
        ("CALC:MARK:MODE DELT", -141),
        ("CALC:MARK:FUNC:BAND:SPAN -1", -222),
        ("CONF:XYZ", -113),
        ("MEAS:CHP", -113),
        ("READ:CHP? 1", -108),
        ("CALC:MARK:SET:CENT", -221),
    ],
)
def test_wrong_unit_queues_its_error_and_answers_nothing(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]


def test_initiate_of_a_measurement_is_refused_while_sweeping_without_end(bench: Any) -> None:
    bench.ask("INIT:CONT ON;:INIT:CHP")
    assert bench.errors() == [-213]


def test_reset_returns_to_the_spectrum(bench: Any) -> None:
    bench.ask("CONF:CHP;:CHP:BAND:INT 5 MHZ;*RST")
    assert bench.ask("CONF?;:CHP:BAND:INT?") == "SAN;2000000"
