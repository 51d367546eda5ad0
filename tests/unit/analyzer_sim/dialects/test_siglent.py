"""Siglent: the comma at the end of a trace, 751 points, filter steps, the end of a sweep, channel power."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BWID 30 KHZ;:SWE:TIME 0.2;:DET:TRAC1 AVER"

# carriers of the bench: a 1012 MHz 1 MHz -40 dBm, b 1017 MHz 2 MHz -43 dBm, c 1022 MHz 0.5 MHz -46 dBm; -120 dBm/Hz
#: b and the noise of 3 MHz
B_DBM = 10 * math.log10(10**-4.3 + 10 ** ((-120 + 10 * math.log10(3e6)) / 10))


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    return make_bench(dialect="siglent")


@pytest.fixture
def swept(bench: Any) -> Any:
    """A sweep of 10 s that shows mean powers."""
    bench.ask(f"{SETUP};:SWE:TIME 10;:AVER:TYPE POW;:INIT")
    return bench


def numbers(text: str) -> np.ndarray:
    return np.array(text.replace(";", ",").split(","), dtype=float)


@pytest.mark.parametrize("name", ["1", "TRC1", "TRACE1"])
def test_ascii_trace_ends_with_a_comma(bench: Any, name: str) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    fields = bench.ask(f"TRAC:DATA? {name}").split(",")
    assert len(fields) == 752
    assert fields[-1] == ""
    assert np.all(np.isfinite(np.array(fields[:-1], dtype=float)))


def test_block_holds_the_ascii_trace(bench: Any) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    ascii_dbm = np.array(bench.ask("TRAC? 1").split(",")[:-1], dtype=float)
    bench.ask("FORM REAL")
    block = bench.send(b"TRAC? 1\n")
    assert block[:6] == b"#43004"
    np.testing.assert_allclose(np.frombuffer(block[6:-1], "<f4"), ascii_dbm, atol=1e-4)  # seven digits of the text


@pytest.mark.parametrize(("name", "code"), [("2", -230), ("5", -224), ("TRC5", -141), ("FOO1", -141), ("1 HZ", -138)])
def test_other_traces_are_refused(bench: Any, name: str, code: int) -> None:
    bench.ask(SETUP + ";:INIT;*WAI")
    assert bench.ask(f"TRAC:DATA? {name}") == ""
    assert bench.errors() == [code]


def test_number_of_points_is_ignored_without_an_error(bench: Any) -> None:
    assert bench.ask("SWE:POIN 2401;POIN?;POIN? MAX") == "751;751"
    assert bench.errors() == []


@pytest.mark.parametrize(("wanted", "step"), [("31 KHZ", 30e3), ("64 KHZ", 30e3), ("65 KHZ", 100e3), ("2 HZ", 3.0)])
def test_filter_takes_the_nearest_step_rounding_up(bench: Any, wanted: str, step: float) -> None:
    assert float(bench.ask(f"BWID {wanted};:BWID?;:BWID:VID {wanted}")) == step
    assert float(bench.ask("BWID:VID?")) == step


def test_sweep_time_has_the_limits_of_the_manual(bench: Any) -> None:
    assert bench.ask("SWE:TIME? MIN;TIME? MAX") == "0.000917;1000"


def test_end_of_a_sweep_can_be_polled(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect="siglent")
    bench.ask("INIT:CONT OFF;:INIT")
    assert bench.ask("TRAC:SWE:STAT?;:TRAC:SWE:STAT? 1") == "0;0"
    allowed.append(True)
    bench.instrument.complete_pending()
    assert bench.ask("TRAC:SWE:STAT?") == "1"


@pytest.mark.parametrize(("kind", "detector"), [("POW", "RMS"), ("LOGP", "AVER"), ("VOLT", "LIN")])
def test_average_detector_follows_the_average_type(bench: Any, kind: str, detector: str) -> None:
    bench.ask(f"AVER:TYPE {kind};:DET:TRAC1 AVER")
    assert bench.instrument.settings.detector == detector
    assert bench.ask("DET:TRAC1?") == "AVER"


def test_default_is_the_positive_peak(bench: Any) -> None:
    assert bench.ask("DET:TRAC?;:AVER:TYPE?;:AVER:TRAC1:COUN?") == "POS;LOGP;100"


def test_filter_type_is_remembered_and_byte_order_unknown(bench: Any) -> None:
    assert bench.ask("FILT:TYPE EMI;TYPE?;:FILT:TYPE GAUSS;:FILT:TYPE?") == "EMI;GAUSS"
    bench.ask("FORM:BORD SWAP")
    assert bench.errors() == [-113]


def test_channel_power_and_density(swept: Any) -> None:
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


def test_channel_power_waits_until_its_row_is_allowed(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect="siglent")
    bench.ask("*RST;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ")
    assert bench.ask("MEAS:CHP:CHP?") == ""
    allowed.append(True)
    bench.instrument.complete_pending()
    assert float(bench.go_on()) < 0.0


def test_measurement_on_the_screen(bench: Any) -> None:
    assert bench.ask("INST:MEAS?;MEAS CHP;MEAS?;MEAS OFF;MEAS?") == "OFF;CHP;OFF"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("CHP:BWID:INT 1", -222),
        ("CHP:BWID:INT 4 GHZ", -222),
        ("INST:MEAS OBW", -141),
        ("MEAS:CHP", -113),
        ("MEAS:CHP? 1", -108),
        ("FREQ:SPAN 0;:MEAS:CHP?", -221),
    ],
)
def test_wrong_unit_of_channel_power_queues_its_error(swept: Any, message: str, code: int) -> None:
    assert swept.ask(message) == ""
    assert swept.errors() == [code]
