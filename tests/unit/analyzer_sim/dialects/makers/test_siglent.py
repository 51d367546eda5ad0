"""Siglent: the comma at the end of a trace, 751 points, filter steps, the poll for the end of a sweep."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from analyzer_sim.dialects.makers.siglent import SIGLENT

SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20e6;:BWID 30 KHZ;:SWE:TIME 0.2;:DET:TRAC1 AVER"


@pytest.fixture
def bench(make_bench: Callable[..., Any]) -> Any:
    return make_bench(dialect=SIGLENT)


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
    block = bench.send("TRAC? 1")
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
    bench = make_bench(may_advance=lambda: bool(allowed), dialect=SIGLENT)
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
