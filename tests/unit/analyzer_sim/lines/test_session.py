"""One client's dialogue beyond the rules of SCPI: turns, interface messages, device clear, the transport's status."""

from collections.abc import Callable
from typing import Any


def test_interface_messages_are_ignored(bench: Any) -> None:
    assert bench.send(b"&GTR\n&GTL\r\n&DCL\n") == b""
    assert bench.errors() == []


def test_long_message_gives_others_a_turn(bench: Any) -> None:
    message = bench.framer.feed(b"*ESE?;" * 1000 + b"\n")[0]
    bench.session.submit(message)
    turns, response = 0, None
    while response is None:
        response = bench.session.run()
        turns += 1
    assert turns == 4  # 1000 units, 256 a turn
    assert response == b"0" + b";0" * 999 + b"\n"


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
