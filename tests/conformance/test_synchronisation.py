"""Overlapped sweeps: *OPC, *OPC?, *WAI, ABORt, INIT while sweeping, settings while sweeping."""

import pytest

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
    assert data.startswith(b"#")
    assert pending.ask("FREQ:CENT?") == "2000000000"
    import numpy as np

    digits = int(data[1:2])
    levels_dbm = np.frombuffer(data[2 + digits : -1], ">f4" if facts.is_big_endian else "<f4")
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
    assert bench.ask("BAND:AUTO?;:BAND:VID:AUTO?;:SWE:TIME:AUTO?;:UNIT:POW?") == "1;1;1;DBM"
    assert bench.ask("FORM?").startswith("ASC")
    assert float(bench.ask(f"{facts.attenuation}?")) == 10.0
    assert float(bench.ask("DISP:WIND:TRAC:Y:RLEV?")) == 0.0
    assert float(bench.ask("FREQ:SPAN?")) == float(bench.ask("FREQ:SPAN? MAX"))
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
