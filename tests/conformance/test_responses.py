"""Responses: one line a message, what failed is missing from it, blocks and lists of numbers."""

import re
from itertools import count

import numpy as np
import pytest

SWEEP = "INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 100 KHZ;:SWE:TIME 0.2"


@pytest.fixture
def swept(bench, facts):
    """A bench after one sweep with power averages."""
    bench.ask(f"*RST;*CLS;:{SWEEP};:{facts.few_points};:{facts.power_detector};:INIT;*WAI")
    assert bench.errors() == []
    return bench


def ascii_levels(answer, facts):
    """Read an ASCII trace as the specification describes it for the maker."""
    if facts.has_ascii_header:
        digits = int(answer[1])
        assert answer[0] == "#"
        assert int(answer[2 : 2 + digits]) == len(answer) - 2 - digits
        answer = answer[2 + digits :]
    assert answer.endswith(",") == facts.has_trailing_comma
    return np.array([float(field) for field in answer.removesuffix(",").split(",")])


def block_payload(data):
    """Read ``#<n><length>``, the payload and the line feed."""
    digits = int(data[1:2])
    size = int(data[2 : 2 + digits])
    assert data[:1] == b"#"
    assert len(data) == 2 + digits + size + 1
    assert data.endswith(b"\n")
    return data[2 + digits : -1]


def test_several_queries_make_one_line(bench):
    assert bench.ask("*ESE 3;*SRE 5;*ESE?;*SRE?;:STAT:OPER:ENAB?") == "3;5;0"


@pytest.mark.parametrize("failing", ["NONE?", "FREQ:CENT? 1 S", "*IDN? 1", "INIT?", "$", "FREQ:CENT 1 S"])
def test_failed_unit_answers_nothing_and_the_others_stay(bench, failing):
    assert bench.ask(f"*ESE?;:{failing};*SRE?".replace(":*", "*").replace(":$", "$")) == "0;0"
    assert len(bench.errors()) == 1


def test_line_of_only_failed_queries_answers_nothing(bench):
    assert bench.send(b"NONE?;:NONE?\n") == b""
    assert bench.errors() == [-113, -113]


def test_ascii_trace_is_numbers_and_commas(swept, facts):
    swept.ask("FORM ASC")
    answer = swept.ask(facts.trace_query)
    body = answer[2 + int(answer[1]) :] if facts.has_ascii_header else answer
    assert re.fullmatch(r"(-?\d\.\d+E[+-]\d\d,?)+", body)
    assert len(ascii_levels(answer, facts)) == facts.points


def test_block_holds_the_same_trace(swept, facts):
    swept.ask("FORM ASC")
    ascii_dbm = ascii_levels(swept.ask(facts.trace_query), facts)
    swept.ask(facts.real32)
    payload = block_payload(swept.send(facts.trace_query.encode() + b"\n"))
    levels_dbm = np.frombuffer(payload, ">f4" if facts.is_big_endian else "<f4")
    np.testing.assert_allclose(levels_dbm, ascii_dbm, atol=1e-4)
    assert swept.errors() == []


def test_trace_shows_the_carriers(swept, facts):
    swept.ask("FORM ASC")
    levels_dbm = ascii_levels(swept.ask(facts.trace_query), facts)
    frequency_hz = np.linspace(1007e6, 1027e6, facts.points)
    step_hz = 20e6 / (facts.points - 1)
    for center_hz, width_hz, power_dbm in ((1012e6, 1.25e6, -40.0), (1017e6, 2.4e6, -43.0), (1022e6, 0.675e6, -46.0)):
        inside = np.abs(frequency_hz - center_hz) < 0.5 * width_hz + 200e3
        total_mw = np.sum(10.0 ** (0.1 * levels_dbm[inside])) * step_hz / (1.0645 * 100e3)
        # points stand 200 kHz apart at twice the RBW: the sum over a band is no better than a few tenths of a dB
        assert 10.0 * np.log10(total_mw) == pytest.approx(power_dbm, abs=0.8)


def test_no_maker_knows_decibel_watts(bench):
    bench.ask("UNIT:POW DBW")
    assert bench.errors()[0] in {-141, -224}


def test_continuous_sweep_gives_fresh_data_each_time(bench, facts):
    bench.ask(f"{SWEEP};:{facts.few_points};:{facts.power_detector};:INIT:CONT ON;:FORM ASC")
    assert bench.ask(facts.trace_query) != bench.ask(facts.trace_query)
    assert bench.errors() == []


def test_single_sweep_keeps_its_data(swept, facts):
    assert swept.ask(facts.trace_query) == swept.ask(facts.trace_query)


def test_block_answers_may_be_joined_with_others(swept, facts):
    swept.ask(facts.real32)
    answer = swept.send(f"*ESE?;:{facts.trace_query};*SRE?\n".encode())
    assert answer.startswith(b"0;#")
    assert answer.endswith(b";0\n")
    assert len(answer) == len(b"0;#") + 1 + int(chr(answer[3])) + 4 * facts.points + len(b";0\n")


def test_line_feeds_stand_inside_blocks(bench, facts):
    bench.ask(f"*RST;:{SWEEP};:{facts.power_detector};:{facts.real32};:INIT;*WAI")
    for _ in count():
        data = bench.send(facts.trace_query.encode() + b"\n")
        if b"\n" in block_payload(data):
            break
        bench.ask("INIT;*WAI")
        assert bench.source.row < 200
    assert bench.errors() == []


def test_sessions_share_settings_and_keep_answers_apart(bench):
    first, second = bench.session, bench.new_session()
    bench.ask("FREQ:CENT 1 GHZ")
    bench.session = second
    assert bench.ask("FREQ:SPAN 1 MHZ;CENT?") == "1000000000"
    bench.session = first
    assert bench.ask("FREQ:SPAN?") == "1000000"


@pytest.mark.parametrize(("is_own", "others", "own"), [(False, [-113], []), (True, [], [-113])])
def test_error_queue_is_the_instruments_or_each_sessions_own(make_bench, is_own, others, own):
    bench = make_bench(is_error_queue_per_session=is_own)
    bench.ask("NONE")
    first, bench.session = bench.session, bench.new_session()
    assert bench.errors() == others
    bench.session = first
    assert bench.errors() == own
