"""The error queue: texts, order, overflow, and every number the specification asks for."""

import re

import pytest

from analyzer_sim.lines.session import OUTPUT_LIMIT_BYTES
from analyzer_sim.scpi.errors import ERROR_TEXTS, event_bit

#: error classes and the bit of the standard event register (IEEE 488.2, 11.5.1.1)
NEEDED = {
    5: [100, 101, 102, 103, 104, 108, 109, 113, 114, 120, 121, 128, 131, 138, 141, 144, 148, 151, 158, 161, 168],
    4: [200, 203, 211, 213, 221, 222, 223, 224, 230],
    3: [300, 310, 350],
    2: [400, 410, 420, 430, 440],
}


@pytest.mark.parametrize(("code", "bit"), [(-number, bit) for bit, numbers in NEEDED.items() for number in numbers])
def test_number_is_known_with_its_class(code, bit):
    assert ERROR_TEXTS[code]
    assert event_bit(code) == bit


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("&XYZ", -101),
        ("FREQ:CENT $5", -101),
        ("FREQ::CENT 1", -102),
        ("FREQ:CENT,1", -103),
        ("FREQ:CENT (@1)", -104),
        ("*RST 1", -108),
        ("*OPC? 1", -108),
        ("FREQ:CENT", -109),
        ("FREQ:CNT 1", -113),
        ("FREQ:CENT +", -120),
        ("FREQ:CENT 1.2.3", -121),
        ("UNIT:POW 5", -128),
        ("FREQ:CENT? 1", -128),
        ("FREQ:CENT 1 S", -131),
        ("*ESE 1 HZ", -138),
        ("FORM NONSENSE", -141),
        ("BAND:AUTO MAYBE", -141),
        ("FORM REAL,16", -224),
        (f"UNIT:POW {'A' * 33}", -144),
        ("*ESE MAX", -148),
        ("FREQ:CENT 'a'b", -151),
        ("FREQ:CENT '1'", -158),
        ("FREQ:CENT #1x", -161),
        ("FREQ:CENT #13abc", -168),
        ("FREQ:CENT 1E30", -222),
    ],
)
def test_message_gives_its_number(bench, message, code):
    assert bench.ask(message) == ""
    assert bench.errors() == [code]


def test_entry_is_number_and_text_in_quotes(bench, facts):
    bench.ask("FREQ:CNT 1")
    assert re.fullmatch(r'-113,"Undefined header(;[^"]*)?"', bench.ask("SYST:ERR?"))
    assert bench.ask("SYST:ERR?") == facts.no_error


@pytest.mark.parametrize("detail", ['NONE"A"', "N'\"'", "NÖNE", "X\tY", "A\x00B", "A" * 500])
def test_entry_stays_one_printable_string_whatever_was_sent(bench, facts, detail):
    bench.ask(detail)
    entry = bench.ask("SYST:ERR?")
    assert re.fullmatch(r'-\d+,"[ !#-~]+"', entry)
    assert len(entry) <= 255


def test_queue_is_first_in_first_out_and_reading_pops(bench):
    bench.ask("NONE;:FREQ:CENT 1 S;:FREQ:CENT 1E30;*RST 1")
    assert bench.ask("SYST:ERR:COUN?") == "4"
    assert bench.errors() == [-113, -131, -222, -108]
    assert bench.ask("SYST:ERR:COUN?") == "0"


@pytest.mark.parametrize("header", ["SYST:ERR?", "SYST:ERR:NEXT?", "SYSTem:ERRor:NEXT?", "syst:err?"])
def test_spellings_of_the_query(bench, header):
    bench.ask("NONE")
    assert bench.ask(header).startswith("-113,")


def test_all_errors_at_once(bench, facts):
    assert bench.ask("SYST:ERR:ALL?") == facts.no_error
    bench.ask("NONE;*RST 1")
    assert re.fullmatch(r'-113,"[^"]*",-108,"[^"]*"', bench.ask("SYST:ERR:ALL?"))
    assert bench.errors() == []


def test_overflow_replaces_the_last_entry(bench, facts):
    bench.ask("FREQ:CENT 1 S")
    for _ in range(99):
        bench.ask("NONE")
    depth = int(bench.ask("SYST:ERR:COUN?"))
    assert facts.queue_depths[0] <= depth <= facts.queue_depths[1]
    assert int(bench.ask("*ESR?")) & 8
    codes = bench.errors()
    assert codes == [-131, *[-113] * (depth - 2), -350]


def test_queue_takes_entries_again_after_one_was_read(bench, facts):
    for _ in range(99):
        bench.ask("NONE")
    bench.ask("SYST:ERR?")
    bench.ask("*RST 1")
    assert bench.errors()[-2:] == [-350, -108]


@pytest.mark.parametrize("clear", ["*CLS", ":SYST:ERR:CLE", ":SYST:ERR:CLE:ALL"])
def test_clear_empties_the_queue(bench, facts, clear):
    bench.ask(f"NONE;:NONE;{clear}")
    assert bench.ask("SYST:ERR?") == facts.no_error


def test_response_beyond_the_output_queue_is_a_deadlock(bench, facts):
    bench.ask(f"*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:{facts.power_detector};:FORM ASC;:INIT;*WAI")
    traces = -(-OUTPUT_LIMIT_BYTES // len(bench.ask(facts.trace_query)))
    assert bench.ask("*ESE?;" + f":{facts.trace_query};" * (traces + 1) + "*ESE 7") == ""
    assert bench.errors() == [-430]
    assert int(bench.ask("*ESR?")) & 4
    assert bench.ask("*ESE?") == "0", "the rest of the message is dropped with the response"


def test_query_behind_an_indefinite_response_is_unterminated(bench, facts):
    bench.ask("*CLS;:INIT:CONT OFF")
    answer = bench.ask(f"{facts.trace_query};*ESE?")
    if facts.no_trace.startswith("#0"):
        assert (answer, bench.errors()) == (facts.no_trace, [-440])
    else:
        assert (answer, bench.errors()) == ("0", [-230])
