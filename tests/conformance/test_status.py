"""Status: errors and their queue, registers, responses, synchronisation."""

import re

import numpy as np
import pytest
from scpi_bench import block_payload

from analyzer_sim.lines.dispatcher import OUTPUT_LIMIT_BYTES
from analyzer_sim.scpi.errors import ERROR_TEXTS, event_bit
from analyzer_sim.scpi.status import OPERATION_WAITING_FOR_TRIGGER


def test_power_on_is_set_once_at_start(bench):
    assert bench.ask("*ESR?;*ESR?") == "128;0"


@pytest.mark.parametrize(
    ("message", "bit"),
    [("NONE", 5), ("FREQ:CENT 1 S", 5), ("FREQ:CENT 1E30", 4), ("UNIT:POW DBM;:INIT:CONT ON;:INIT", 4)],
)
def test_each_class_of_errors_sets_its_event_bit(bench, message, bit):
    bench.ask(f"*CLS;:{message}")
    assert bench.ask("*ESR?") == str(1 << bit)


def test_error_bit_of_the_status_byte(bench):
    bench.ask("*CLS")
    assert int(bench.ask("*STB?")) & 4 == 0
    bench.ask("NONE")
    assert int(bench.ask("*STB?")) & 4 == 4
    bench.errors()
    assert int(bench.ask("*STB?")) & 4 == 0


def test_message_available_when_an_earlier_unit_has_answered(bench):
    bench.ask("*CLS")
    assert bench.ask("*STB?;*STB?") == "0;16"


def test_event_summary_needs_its_enable(bench):
    bench.ask("*CLS;*ESE 32;:NONE")
    assert int(bench.ask("*STB?")) & 32
    bench.ask("*ESE 0")
    assert not int(bench.ask("*STB?")) & 32
    bench.ask("*ESE 255")
    assert bench.ask("*ESR?;*STB?").split(";")[0] == "32"
    assert not int(bench.ask("*STB?")) & 32


def test_master_summary_needs_the_service_enable(bench):
    bench.ask("*CLS;*SRE 0;*ESE 1;*OPC")
    assert bench.ask("*STB?") == "32"
    bench.ask("*SRE 32")
    assert bench.ask("*STB?") == str(32 + 64)
    bench.ask("*SRE 255")
    assert bench.ask("*SRE?") == str(255 - 64)


def test_operation_register_tells_of_the_sweep(bench):
    bench.ask("INIT:CONT OFF;:STAT:OPER:ENAB 65535;:STAT:OPER?;*CLS")
    bench.allow(False)
    bench.ask("INIT")
    condition = int(bench.ask("STAT:OPER:COND?"))
    assert condition & (OPERATION_WAITING_FOR_TRIGGER | 8)
    assert int(bench.ask("*STB?")) & 128
    assert int(bench.ask("STAT:OPER:EVEN?")) & condition == condition
    assert not int(bench.ask("*STB?")) & 128
    bench.allow(True)
    assert bench.ask("STAT:OPER:COND?") == "0"


def test_questionable_register_tells_of_an_uncalibrated_sweep(bench, facts):
    bench.ask("STAT:QUES:ENAB 32767;:INIT:CONT OFF;:FREQ:CENT 1 GHZ;SPAN 100 MHZ;:BAND 10 KHZ;:SWE:TIME 1;:INIT;*WAI")
    assert int(bench.ask("STAT:QUES:COND?")) & facts.uncalibrated
    assert int(bench.ask("*STB?")) & 8
    bench.ask("SWE:TIME 100;:INIT;*WAI")
    assert not int(bench.ask("STAT:QUES:COND?")) & facts.uncalibrated
    assert int(bench.ask("STAT:QUES?")) & facts.uncalibrated
    assert not int(bench.ask("*STB?")) & 8


def test_questionable_register_tells_of_an_overload(bench, facts):
    bench.ask("*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 100 KHZ;:DISP:WIND:TRAC:Y:RLEV -80;:INIT;*WAI")
    assert int(bench.ask("STAT:QUES:COND?")) & 8
    bench.ask("DISP:WIND:TRAC:Y:RLEV -20;:INIT;*WAI")
    assert not int(bench.ask("STAT:QUES:COND?")) & 8


@pytest.mark.parametrize("register", ["STAT:OPER", "STAT:QUES", "STATus:OPERation", "STATus:QUEStionable"])
def test_registers_have_event_condition_and_enable(bench, register):
    bench.ask(f"{register}:ENAB 5")
    assert bench.ask(f"{register}:ENAB?;COND?") == "5;0"
    bench.ask("STAT:PRES")
    assert bench.ask(f"{register}:ENAB?;EVEN?;:{register}?").startswith("0;")
    bench.ask(f"{register}:ENAB #HFFFF")
    assert bench.ask(f"{register}:ENAB?") == "32767"
    assert bench.errors() == []


def test_filters_of_edges_decide_what_is_latched_until_a_preset(bench):
    assert bench.ask("STAT:OPER:PTR?;NTR?;PTR 0;NTR 32;PTR?;NTR?") == "32767;0;0;32"
    bench.ask("INIT:CONT OFF;*CLS")
    bench.allow(False)
    bench.ask("INIT")
    assert bench.ask("STAT:OPER?") == "0"
    bench.allow(True)
    assert bench.ask("STAT:OPER?") == "32"
    assert bench.ask("STAT:PRES;:STAT:OPER:PTR?;NTR?") == "32767;0"
    assert bench.errors() == []


def test_clear_empties_events_and_errors_and_leaves_the_enables(bench):
    bench.ask("*ESE 60;*SRE 4;:STAT:OPER:ENAB 8;:NONE;*CLS")
    assert bench.ask("*ESR?;*ESE?;*SRE?;:STAT:OPER:ENAB?;:STAT:OPER?") == "0;60;4;8;0"
    assert bench.errors() == []


def test_reset_leaves_status_and_queues(bench):
    bench.ask("*ESE 60;:NONE;*RST")
    assert bench.ask("*ESE?") == "60"
    assert bench.errors() == [-113]


@pytest.mark.parametrize(
    ("message", "codes"), [("*ESE 256", [-222]), ("*SRE -1", [-222]), ("*ESE 1 HZ", [-138]), ("*ESE MAX", [-148])]
)
def test_masks_refuse_what_is_no_mask(bench, message, codes):
    bench.ask(message)
    assert bench.errors() == codes


def test_self_test_passes_and_version_is_told(bench):
    assert bench.ask("*TST?") in {"0", "+0"}
    assert bench.ask("SYST:VERS?").startswith("19")
    assert bench.ask("*OPT?") != ""
    assert bench.errors() == []


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
        ("FREQ:CENT 1,2", -108),
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
def test_message_gives_its_number_and_changes_no_setting(bench, message, code):
    before = bench.ask("FREQ:CENT?")
    assert bench.ask(message) == ""
    assert bench.errors() == [code]
    assert code == -222 or bench.ask("FREQ:CENT?") == before


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
        answer = block_payload(answer.encode() + b"\n").decode()
    assert answer.endswith(",") == facts.has_trailing_comma
    return np.array([float(field) for field in answer.removesuffix(",").split(",")])


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


SETUP = "*RST;*CLS;:INIT:CONT OFF;:FREQ:CENT 1017 MHZ;SPAN 20 MHZ;:BAND 100 KHZ"


@pytest.fixture
def pending(bench, facts):
    """A bench whose sweep has begun and not ended."""
    bench.ask(f"{SETUP};:{facts.few_points};:{facts.power_detector};*ESR?")
    bench.allow(False)
    bench.ask("INIT")
    assert bench.instrument.is_pending
    return bench


def test_init_is_overlapped(pending):
    assert pending.ask("*ESE?;:FREQ:CENT?") == "0;1017000000"
    assert pending.errors() == []


def test_opc_query_answers_after_the_sweep(pending):
    assert pending.send(b"*OPC?;*ESE?\n") == b""
    assert pending.session.is_held
    pending.allow(True)
    assert pending.go_on() == b"1;0\n"


def test_opc_query_answers_at_once_when_nothing_is_pending(bench):
    assert bench.ask("*OPC?") == "1"


def test_opc_sets_its_event_bit_later_and_holds_nothing(pending):
    assert pending.ask("*OPC;*ESR?") == "0"
    pending.allow(True)
    assert pending.ask("*ESR?") == "1"
    assert pending.ask("*ESR?") == "0"


def test_opc_without_a_sweep_sets_its_event_bit_now(bench):
    bench.ask("*CLS;*OPC")
    assert bench.ask("*ESR?") == "1"


def test_wai_holds_the_parser_of_its_session_only(pending):
    assert pending.send(b"*ESE?;*WAI;*SRE?\n") == b""
    first, pending.session = pending.session, pending.new_session()
    assert pending.ask("*ESE?") == "0"
    pending.session = first
    pending.allow(True)
    assert pending.go_on() == b"0;0\n"


def test_trace_query_waits_for_the_sweep(pending, facts):
    pending.ask(facts.real32)
    assert pending.send(facts.trace_query.encode() + b"\n") == b""
    pending.allow(True)
    assert pending.go_on().startswith(b"#")
    assert pending.errors() == []


def test_init_while_sweeping_is_ignored_with_an_error(pending):
    pending.ask("INIT")
    assert pending.errors() == [-213]
    pending.allow(True)
    assert pending.source.row == 1


def test_init_in_continuous_sweep_is_ignored_with_an_error(bench):
    bench.ask("INIT:CONT ON;:INIT")
    assert bench.errors() == [-213]
    assert bench.source.row == 0


def test_abort_ends_the_sweep_and_operations_are_complete(pending, facts):
    pending.ask("*OPC;:ABOR")
    assert not pending.instrument.is_pending
    assert pending.ask("*OPC?;*ESR?") == "1;1"
    assert pending.source.row == 0
    assert pending.errors() == []


def test_abort_lets_a_held_session_go_on(pending):
    assert pending.send(b"*OPC?\n") == b""
    first, pending.session = pending.session, pending.new_session()
    pending.ask("ABOR")
    pending.session = first
    assert pending.go_on() == b"1\n"


def test_settings_sent_while_sweeping_are_those_of_the_trace(pending, facts):
    pending.ask(f"FREQ:CENT 2 GHZ;:{facts.real32}")
    assert pending.instrument.is_pending
    pending.send(facts.trace_query.encode() + b"\n")
    pending.allow(True)
    data = pending.go_on()
    assert pending.ask("FREQ:CENT?") == "2000000000"
    levels_dbm = np.frombuffer(block_payload(data), ">f4" if facts.is_big_endian else "<f4")
    assert np.max(levels_dbm) < -60.0, "no carrier stands at 2 GHz"


def test_settings_changed_after_the_sweep_leave_no_stale_trace(bench, facts):
    bench.ask(f"{SETUP};:{facts.few_points};:INIT;*WAI;:FREQ:SPAN 10 MHZ")
    assert bench.ask(facts.trace_query) == facts.no_trace
    assert bench.errors() == ([] if facts.no_trace else [-230])


def test_display_unit_leaves_the_trace_valid(bench, facts):
    bench.ask(f"{SETUP};:{facts.few_points};:INIT;*WAI;:FORM ASC")
    before = bench.ask(facts.trace_query)
    bench.ask("UNIT:POW W;:UNIT:POW DBM")
    assert bench.ask(facts.trace_query) == before


def test_reset_ends_the_sweep_and_forgets_the_wanted_completion(pending, facts):
    pending.ask("*OPC;*RST")
    assert pending.ask("*ESR?") == "0"
    assert pending.ask("*OPC?") == "1"
    assert pending.ask("INIT:CONT?") == str(int(facts.is_continuous_after_reset))


def test_state_after_reset_and_after_preset(bench, facts):
    bench.ask("INIT:CONT OFF;:SYST:PRES")
    assert bench.ask("INIT:CONT?") == str(int(facts.is_continuous_after_preset))
    bench.ask("INIT:CONT OFF;*RST")
    assert bench.ask("INIT:CONT?") == str(int(facts.is_continuous_after_reset))
    assert bench.errors() == []


def test_trigger_common_command_starts_a_sweep(bench):
    bench.ask("INIT:CONT OFF;*TRG;*WAI")
    assert bench.errors() == []
    assert bench.source.row == 1


def test_end_of_the_story_is_an_execution_error_and_no_trace(make_bench, facts):
    bench = make_bench(rows=1)
    bench.ask(f"{SETUP};:{facts.few_points}")
    for expected in ([], [-200]):
        bench.ask("INIT;*WAI")
        assert bench.errors() == expected
    assert bench.ask(facts.trace_query) == facts.no_trace
    assert bench.errors() == ([] if facts.no_trace else [-230])
