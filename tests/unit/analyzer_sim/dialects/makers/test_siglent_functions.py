"""Siglent measurement functions on the trace shown."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analyzer_sim.dialects.makers.siglent import SIGLENT

# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
SETUP = (
    "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 30 KHZ;"
    ":SWE:TIME 10;:DET:TRAC1 AVER;:AVER:TYPE POW;:INIT"
)
#: b and the noise of 3 MHz
B_DBM = 10 * math.log10(10**-4.3 + 10 ** ((-120 + 10 * math.log10(3e6)) / 10))


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    made = make_bench(dialect=SIGLENT)
    made.ask(SETUP)
    return made


def numbers(text: str) -> np.ndarray:
    return np.array(text.replace(";", ",").split(","), dtype=float)


def test_channel_power_and_density(bench: Any) -> None:
    assert bench.ask("CHP:BWID:INT?") == "2000000"
    values = numbers(bench.ask("CHP:BWID:INT 3 MHZ;:MEAS:CHP?;:MEAS:CHP:CHP?;:MEAS:CHP:DENS?"))
    assert values[0] == pytest.approx(B_DBM, abs=0.08)
    assert values[1] == pytest.approx(values[0] - 10 * math.log10(3e6), abs=1e-6)
    assert values[2:].tolist() == values[:2].tolist()
    assert bench.source.row == 1  # all from the trace there was


def test_channel_as_wide_as_the_span(bench: Any) -> None:
    whole = float(bench.ask("CHP:FREQ:SPAN:POW;:CHP:BWID:INT?;:MEAS:CHP:CHP?").split(";")[1])
    total_mw = 10**-4.0 + 10**-4.3 + 10**-4.6 + 20e6 * 1e-12
    assert whole == pytest.approx(10 * math.log10(total_mw), abs=0.1)


def test_measure_sweeps_only_when_the_settings_have_changed(bench: Any) -> None:
    bench.ask("MEAS:CHP?;:MEAS:OBW?")
    assert bench.source.row == 1
    bench.ask("FREQ:SPAN 10 MHZ;:MEAS:CHP?;:MEAS:CHP?")
    assert bench.source.row == 2
    bench.ask("INIT:CONT ON;:MEAS:CHP?;:MEAS:CHP?")
    assert (bench.source.row, bench.errors()) == (2, [])


def test_measure_holds_until_its_row_is_allowed(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect=SIGLENT)
    bench.ask("*RST;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ")
    assert bench.ask("MEAS:CHP:CHP?") == ""
    allowed.append(True)
    bench.instrument.complete_pending()
    assert float(bench.go_on()) < 0.0


def test_occupied_bandwidth_by_percent_and_by_level(bench: Any) -> None:
    bench.ask("FREQ:SPAN 6 MHZ;:FREQ:OFFS 1 GHZ;:INIT;:OBW:PERC 90")
    values = numbers(bench.ask("MEAS:OBW?;:MEAS:OBW:OBW?;:MEAS:OBW:CENT?;:MEAS:OBW:OBW:FERR?"))
    assert values[0] == pytest.approx(2.0e6, abs=0.1e6)
    assert values[1] == pytest.approx(2017e6, abs=20e3)  # the offset is shown
    assert values[2:4].tolist() == values[:2].tolist()
    assert values[4] == pytest.approx(values[1] - 2017e6, abs=0.1)
    by_level = numbers(bench.ask("OBW:METH DBC;XDB 6;:MEAS:OBW:OBW?"))
    assert by_level[0] == pytest.approx(2.1e6, rel=0.05)
    assert bench.ask("OBW:METH?;XDB?;PERC?") == "DBC;6;90"


def test_neighbours(bench: Any) -> None:
    bench.ask("ACPR:BWID:INT 3 MHZ;:ACPR:OFFS 5 MHZ;:ACPR:OFFS:BWID 1.5 MHZ")
    main, lower, upper, lower_db, upper_db = numbers(
        bench.ask("MEAS:ACPR:MAIN?;:MEAS:ACPR:LOW:POW?;:MEAS:ACPR:UPP:POW?;:MEAS:ACPR:LOW?;:MEAS:ACPR:UPP?")
    )
    assert (main, lower, upper) == pytest.approx((B_DBM, -40.0, -45.8), abs=0.2)
    assert (lower_db, upper_db) == pytest.approx((lower - main, upper - main), abs=1e-9)


def test_markers(bench: Any) -> None:
    bench.ask("CALC:MARK1:STAT ON;:CALC:MARK1:X 1008.5 MHZ;:CALC:MARK1:FUNC NOIS")
    assert float(bench.ask("CALC:MARK1:Y?")) == pytest.approx(-120.0, abs=0.3)
    assert bench.ask("CALC:MARK1:FUNC?;MODE?;X:READ?") == "NOIS;POS;FREQ"
    bench.ask("CALC:MARK2:MAX;:CALC:MARK:PEAK:EXC 10")
    assert float(bench.ask("CALC:MARK2:X?")) == pytest.approx(1012e6, abs=0.6e6)
    bench.ask("CALC:MARK2:MAX:RIGH")
    assert float(bench.ask("CALC:MARK2:X?")) == pytest.approx(1022e6, abs=0.3e6)
    assert bench.ask("CALC:MARK2:MODE OFF;STAT?") == "0"


def test_measurement_on_the_screen(bench: Any) -> None:
    assert bench.ask("INST:MEAS?;MEAS CHP;MEAS?;MEAS OFF;MEAS?") == "OFF;CHP;OFF"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("CHP:BWID:INT 1", -222),
        ("CHP:BWID:INT 4 GHZ", -222),
        ("OBW:PERC 100", -222),
        ("OBW:METH WIDE", -141),
        ("MEAS:CHP", -113),
        ("MEAS:CHP? 1", -108),
        ("CALC:MARK5:X?", -114),
        ("CALC:MARK1:Y?", -221),
        ("CALC:MARK1:FUNC BPOW", -141),
        ("FREQ:SPAN 0;:MEAS:CHP?", -221),
    ],
)
def test_wrong_unit_queues_its_error_and_answers_nothing(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]
