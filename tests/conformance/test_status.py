"""Status byte, standard event register, SCPI registers."""

import pytest

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
