"""The rules of syntax and protocol (analyzer specification, section 1) hold in every dialect."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.scpi.errors import ERROR_TEXTS

#: error numbers the specification asks for
NEEDED_CODES = (
    *(-100, -101, -102, -103, -104, -108, -109, -113, -114, -120, -121, -128, -131, -138, -141, -144, -148, -151),
    *(-158, -161, -168, -200, -203, -211, -213, -221, -222, -223, -224, -230, -300, -310, -350),
    *(-400, -410, -420, -430, -440),
)
TRACE = {"rs": "TRACE1", "keysight": "TRACE1", "siglent": "1", "anritsu": "1"}


@pytest.fixture(params=DIALECTS)
def dialect(request: pytest.FixtureRequest) -> Dialect:
    return DIALECTS[request.param]


@pytest.fixture
def bench(make_bench: Callable[..., Any], dialect: Dialect) -> Any:
    made = make_bench(dialect=dialect)
    made.ask("*CLS;*ESR?")
    return made


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        (":SENS:FREQ:CENT 1 GHZ;SPAN 2 MHZ;CENT?;SPAN?", "1000000000;2000000"),
        ("FREQ:CENT 1 GHZ;*ESE 4;SPAN?;*ESE?", None),
        ("FREQ:CENT 1.01325e+09;CENT?", "1013250000"),
        ("FREQ:CENT 1.013 GHz;CENT?", "1013000000"),
        ("FREQ:CENT 1.010000e+09 Hz;CENT?", "1010000000"),
        ("FREQ:CENT 5000000.0;CENT?", "5000000"),
        ("FREQ:CENT 1000MHz;:freq:cent?", "1000000000"),
        ("FREQUENCY:CENTER #H3B9ACA00;CENTer?", "1000000000"),
        ("FREQ:CENT #Q7346545000;CENT?", "1000000000"),
        ("FREQ:SPAN #B11110100001001000000;SPAN?", "1000000"),
        ("BAND 30 kHz;:BAND?", "30000"),
        (":FREQ:STAR 1 GHZ;;:FREQ:STAR?;", "1000000000"),
        ("SWE:TIME 20000 US;TIME?", "0.02"),
        ("*ESE #HFF;*ESE?", "255"),
        ("INIT:CONT 0;CONT?;CONT ON;CONT?;CONT OFF;CONT?;CONT 1;CONT?", "0;1;0;1"),
        ("*OPC?;*ESE?;*SRE?;*TST?", "1;0;0;0"),
        ("SYST:ERR:COUN?;VERS?", None),
        (":SYST:VERS?", "1999.0"),
        ("STAT:OPER:PTR?;NTR?;NTR 32;NTR?;:STAT:PRES;:STAT:OPER:NTR?", "32767;0;32;0"),
        ("STAT:QUES:ENAB 8;ENAB?;EVEN?;COND?;:STAT:PRES;:STAT:QUES:ENAB?", "8;0;0;0"),
    ],
)
def test_message_is_understood(bench: Any, message: str, answer: str | None) -> None:
    got = bench.ask(message)
    if answer is not None:
        assert got == answer
        assert bench.errors() == []
    else:
        assert got


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("FREQ:CENT 1 GHZ;FREQ:SPAN 2 MHZ", -113),
        ("FREQ:CENTE 1", -113),
        ("FREQ:CENT", -109),
        ("FREQ:CENT 1,2", -108),
        ("FREQ:CENT 1 S", -131),
        ("FREQ:CENT 'a'", -158),
        ("FREQ:CENT FAST", -141),
        ("FREQ:CENT #11a", -168),
        ("FREQ:CENT? 1", -128),
        ("FREQ:CENT 1.2.3", -121),
        ("FREQ:CENT +", -120),
        ("FREQ:CENT (1)", -104),
        ("FREQ:CENT,1", -103),
        ("FREQ::CENT 1", -102),
        ("UNIT:POW 'a'b'c'", -151),
        ("UNIT:POW #x", -161),
        ("UNIT:POW 1", -128),
        ("BAND:AUTO MAYBE", -141),
        ("*ESE MAX", -148),
        ("*ESE 256", -222),
        ("INIT:CONT ON;:INIT:IMM", -213),
        ("FORM BITS", -141),
        ("FORM REAL,16", -224),
    ],
)
def test_wrong_message_has_its_error_and_no_answer(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]


#: measurement functions of the real instruments that are not simulated
UNKNOWN_FUNCTIONS = {
    "rs": ("CALC:MARK1:X?", "POW:ACH:SPAC?", "FETC:POW:ACP?", "LIST:POW:RES?", "ADJ:LEV"),
    "keysight": ("CALC:MARK1:X?", "READ:ACP?", "READ:OBW?", "FREQ:TUNE:IMM"),
    "siglent": ("CALC:MARK1:X?", "MEAS:ACPR:MAIN?", "MEAS:OBW?", "FREQ:TUNE:IMM"),
    "anritsu": ("CALC:MARK1:X?", "READ:ACP?", "READ:OBW?", "FETC:PEAK?"),
}


def test_measurement_functions_but_channel_power_are_unknown(bench: Any, dialect: Dialect) -> None:
    for message in UNKNOWN_FUNCTIONS[dialect.name]:
        assert bench.ask(message) == ""
        assert bench.errors() == [-113], message


def test_suffix_out_of_range_is_its_own_error(bench: Any, dialect: Dialect) -> None:
    trace = {"rs": "DISP:TRAC9:MODE?", "siglent": "TRAC9:MODE?"}.get(dialect.name, "TRAC9:TYPE?")
    assert bench.ask(trace) == ""
    assert bench.errors() == [-114]


def test_lenient_dialect_looks_from_the_root(make_bench: Callable[..., Any], dialect: Dialect) -> None:
    bench = make_bench(dialect=replace(dialect, is_lenient=True))
    assert bench.ask("FREQ:CENT 1 GHZ;FREQ:SPAN 2 MHZ;SPAN?;CENT?") == "2000000;1000000000"
    assert bench.errors() == []


def test_keywords_of_numbers_are_taken_and_asked_for(bench: Any, dialect: Dialect) -> None:
    high_hz = dialect.model.max_frequency_hz
    assert bench.ask("FREQ:STOP? MIN;STOP? MAX;STOP? DEF;STOP MIN;STOP?") == (
        f"{dialect.model.min_span_hz:.12g};{high_hz:.12g};{high_hz:.12g};{dialect.model.min_span_hz:.12g}"
    )
    bench.ask("FREQ:CENT 1 GHZ;SPAN 100 MHZ")
    assert bench.ask("FREQ:CENT UP;CENT?;CENT DOWN;CENT?;CENT? UP") == "1010000000;1000000000;1010000000"
    steps = dialect.model.rbw.steps_hz
    assert bench.ask("BAND MIN;:BAND UP;:BAND?;:BAND MAX;:BAND DOWN;:BAND?") == f"{steps[1]:.12g};{steps[-2]:.12g}"
    assert bench.errors() == []


def test_value_out_of_range_is_clamped_and_reported(bench: Any, dialect: Dialect) -> None:
    model = dialect.model
    bench.ask("FREQ:STOP 1E12;:BAND 1E12;:SWE:TIME 1E9")
    assert bench.errors() == [-222, -222, -222]
    expected = (model.max_frequency_hz, model.rbw.steps_hz[-1], model.sweep_time_s.high)
    assert bench.ask("FREQ:STOP?;:BAND?;:SWE:TIME?") == ";".join(f"{value:.12g}" for value in expected)


def test_span_start_and_stop_stay_consistent(bench: Any) -> None:
    assert bench.ask("FREQ:CENT 1 GHZ;SPAN 36 MHZ;STAR?;STOP?") == "982000000;1018000000"
    assert bench.ask("FREQ:STAR 954 MHZ;STOP 990 MHZ;CENT?;SPAN?") == "972000000;36000000"


def test_failed_query_leaves_the_answers_of_its_line(bench: Any) -> None:
    assert bench.ask("*ESE?;:NONE?;*SRE?;*OPC?") == "0;0;1"
    assert bench.errors() == [-113]


def test_empty_error_queue_answers_in_the_style_of_the_maker(bench: Any, dialect: Dialect) -> None:
    text = '+0,"No error"' if dialect.name == "keysight" else '0,"No error"'
    assert bench.ask("SYST:ERR?;ERR:NEXT?;ALL?;COUN?") == f"{text};{text};{text};0"


def test_overflow_replaces_the_last_error_and_all_are_read_at_once(bench: Any, dialect: Dialect) -> None:
    depth = dialect.model.error_queue_depth
    assert 20 <= depth <= 30
    for _ in range(depth + 3):
        bench.ask("NONE")
    assert bench.ask("SYST:ERR:COUN?") == str(depth)
    entries = bench.ask("SYST:ERR:ALL?").split('",')
    assert len(entries) == depth
    assert entries[0] == '-113,"Undefined header;NONE'
    assert entries[-1] == '-350,"Queue overflow"'
    assert bench.ask("*STB?") == "0"
    for emptied in ("*CLS", ":SYST:ERR:CLE:ALL"):
        bench.ask(f"NONE;{emptied}")
        assert bench.errors() == []


def test_every_error_number_needed_has_a_text() -> None:
    assert set(NEEDED_CODES) <= set(ERROR_TEXTS)


def test_sessions_share_the_error_queue_unless_the_model_keeps_one_for_each(
    make_bench: Callable[..., Any], dialect: Dialect
) -> None:
    for is_alone in (False, True):
        model = replace(dialect.model, is_error_queue_per_session=is_alone)
        bench = make_bench(dialect=replace(dialect, model=model))
        first, second = bench.session, bench.new_session()
        bench.ask("NONE")
        bench.session = second
        assert bench.errors() == ([] if is_alone else [-113])
        assert bench.ask("*STB?") == "0"
        bench.session = first
        assert bench.errors() == ([-113] if is_alone else [])


def test_status_byte_tells_what_is_waiting(bench: Any) -> None:
    assert bench.ask("*ESE 32;*SRE 32;:NONE") == ""
    assert bench.ask("*STB?") == str(4 + 32 + 64)
    assert bench.ask("*ESE?;*STB?").endswith(str(4 + 16 + 32 + 64))
    assert bench.ask("*ESR?;*ESR?;*STB?") == "32;0;20"


def test_sweep_is_overlapped_and_waited_for(make_bench: Callable[..., Any], dialect: Dialect) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed), dialect=dialect)
    bench.ask("*CLS;INIT:CONT OFF;:INIT;*OPC")
    assert bench.ask("*ESR?") == "0"
    waiting = [bench.session]
    for message in ("*OPC?", "*WAI;*ESE?", f"TRAC? {TRACE[dialect.name]}"):
        bench.session = bench.new_session()
        waiting.append(bench.session)
        assert bench.ask(message) == ""
        assert bench.session.is_held
    allowed.append(True)
    bench.instrument.complete_pending()
    for session, length in zip(waiting[1:], (2, 2, 1000), strict=True):
        bench.session = session
        assert len(bench.go_on()) >= length
    bench.session = waiting[0]
    assert bench.ask("*ESR?") == "1"


def test_abort_completes_the_operation(make_bench: Callable[..., Any], dialect: Dialect) -> None:
    bench = make_bench(may_advance=lambda: False, dialect=dialect)
    assert bench.ask("*CLS;INIT:CONT OFF;:INIT;*OPC;:ABOR;*OPC?;*ESR?") == "1;1"


def test_block_with_line_feeds_inside_a_message_does_not_end_it(bench: Any) -> None:
    assert bench.send(b"*ESE #14\n\n\n\n;*ESE?\n") == b"0\n"
    assert bench.errors() == [-168]
