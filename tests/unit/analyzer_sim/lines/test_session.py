"""One client's dialogue: responses, errors, held units."""

from collections.abc import Callable
from typing import Any

import pytest

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parser import parse_unit


def test_several_queries_of_a_message_make_one_line(bench: Any) -> None:
    assert bench.ask("*ESE?;:FORM?;*OPC?") == "0;ASC,0;1"


def test_failed_query_answers_nothing_and_leaves_the_others(bench: Any) -> None:
    assert bench.ask("*ESE?;NONE?;*OPC?") == "0;1"
    assert bench.errors() == [-113]


def test_message_that_answers_nothing_sends_nothing(bench: Any) -> None:
    assert bench.send(b"*CLS\n\n;;\n*ESE 1\n") == b""
    assert bench.errors() == []


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("*OPC? 1", -108),
        ("*ESE", -109),
        ("*ESE 1,2", -108),
        ("*ESE ON", -141),
        ("*ESE MAX", -148),
        ("*ESE 256", -222),
        ("*ESE 1 HZ", -138),
        ("*IDN", -113),
        ("*CLS?", -113),
        ("TRAC?", -109),
        ("FREQ:CENT '1'", -158),
        ("FREQ:CENT #11a", -168),
        ("FREQ:CENT 1 S", -131),
        ("FREQ:CENT 1,", -102),
        ("FREQ:CENT? 1", -128),
        ("DET 5", -128),
        ("UNIT:POW DBW", -141),
        ("FORM REAL,64", -224),
        ("FORM INT,32", -141),
        ("FORM:BORD SWAP", -113),
        ("TRAC? TRACE2", -230),
        ("TRAC? TRACE7", -141),
        ("INST:SEL 'NOISE'", -224),
        ("SENS9:FREQ:CENT?", -114),
        ("&XYZ", -101),
    ],
)
def test_wrong_unit_queues_its_error_and_answers_nothing(bench: Any, message: str, code: int) -> None:
    assert bench.ask(message) == ""
    assert bench.errors() == [code]


def test_message_beyond_the_limit_is_too_much_data(bench: Any) -> None:
    assert bench.send(b"x" * (1 << 20) + b"xx\n") == b""
    assert bench.errors() == [-223]


def test_interface_messages_are_ignored(bench: Any) -> None:
    assert bench.send(b"&GTR\n&GTL\r\n&DCL\n") == b""
    assert bench.errors() == []


def test_path_does_not_outlive_its_message(bench: Any) -> None:
    assert bench.ask("FREQ:OFFS?") == "0"
    assert bench.ask("OFFS?") == ""
    assert bench.errors() == [-113]


def test_sessions_share_errors_and_settings_but_not_answers(bench: Any) -> None:
    first, second = bench.session, bench.new_session()
    bench.ask("NONE;:SWE:POIN 501")
    bench.session = second
    assert bench.ask("SWE:POIN?") == "501"
    assert bench.errors() == [-113]
    bench.session = first
    assert bench.errors() == []


def test_pending_sweep_holds_opc_query_and_trace_but_not_status(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed))
    bench.ask("INIT:CONT OFF")
    assert bench.ask("INIT;*OPC;*STB?;*ESR?") == "0;128"
    assert bench.instrument.is_pending
    for held in ("*OPC?", "*WAI;*ESE?", "TRAC? TRACE1"):
        bench.session = bench.new_session()
        assert bench.ask(held) == ""
        assert bench.session.is_held
    other = bench.session
    bench.session = bench.new_session()
    assert bench.ask("STAT:OPER:COND?") == "32"  # waiting for trigger
    assert bench.ask("INIT") == ""
    assert bench.errors() == [-213]
    allowed.append(True)
    assert bench.instrument.complete_pending()
    assert bench.ask("*OPC?;*ESR?;:STAT:OPER:COND?") == "1;17;0"  # operation complete and the execution error above
    bench.session = other
    assert bench.go_on().count(b",") == 1000


def test_abort_ends_the_wait(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(may_advance=lambda: False)
    bench.ask("INIT:CONT OFF;:INIT;*OPC")
    assert bench.ask("ABOR;*OPC?;*ESR?") == "1;129"
    assert bench.source.row == 0
    assert bench.ask("TRAC? TRACE1") == ""
    assert bench.errors() == [-230]


def test_long_message_gives_others_a_turn(bench: Any) -> None:
    message = bench.framer.feed(b"*ESE?;" * 1000 + b"\n")[0]
    bench.session.submit(message)
    turns, response = 0, None
    while response is None:
        response = bench.session.run()
        turns += 1
    assert turns == 4  # 1000 units, 256 a turn
    assert response == b"0" + b";0" * 999 + b"\n"


def test_response_beyond_the_output_queue_is_dropped_with_the_rest_of_its_message(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("analyzer_sim.lines.session.OUTPUT_LIMIT_BYTES", 8)
    assert bench.ask("*ESE?;:FORM?") == "0;ASC,0"
    assert bench.ask("*ESE 1;*ESE?;:FORM?;:FORM?;*ESE 7;*ESE?") == ""
    monkeypatch.undo()
    assert bench.errors() == [-430]
    assert bench.ask("*ESE?") == "1"


def test_nothing_can_be_asked_behind_an_answer_without_an_end(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.session, "_answers", [b"#0abc"])
    with pytest.raises(ScpiError) as refused:
        bench.session._check_end(parse_unit("*ESE?"))
    assert refused.value.code == -440
    bench.session._check_end(parse_unit("*ESE 1"))


def test_device_clear_drops_what_is_held_and_what_waits(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(may_advance=lambda: False)
    bench.ask("INIT:CONT OFF;:INIT;*OPC")
    assert bench.ask("*ESE?;*OPC?;*ESE 9") == ""
    bench.session.clear()
    assert (bench.session.is_busy, bench.session.is_held, bench.session.readings) == (False, False, ())
    assert bench.ask("*ESE?;:STAT:OPER:COND?") == "0;32", "the sweep goes on"
    bench.ask("ABOR")
    assert bench.ask("*ESR?") == "128", "*OPC was taken back"


def test_transport_sees_the_session_s_own_status(bench: Any) -> None:
    bench.session.push_error(-410, "x")
    assert bench.session.status_byte(has_response=True) == 0b10100
    assert bench.errors() == [-410]
