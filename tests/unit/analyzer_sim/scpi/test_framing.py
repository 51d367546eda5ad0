"""Framing: where a program message ends."""

import pytest

from analyzer_sim.scpi.framing import FramerState, MessageFramer


def bodies(framer: MessageFramer, data: bytes) -> list[bytes]:
    return [message.body for message in framer.feed(data)]


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"*IDN?\n", [b"*IDN?"]),
        (b"*IDN?\r\n", [b"*IDN?"]),
        (b"A;B\nC\n", [b"A;B", b"C"]),
        (b"\n\n", [b"", b""]),
        (b"T 'a\nb'\n", [b"T 'a\nb'"]),
        (b'T "a\nb"\n', [b'T "a\nb"']),
        (b"T 'it''s\n'\nX\n", [b"T 'it''s\n'", b"X"]),
        (b"D #14\n\n\n\n\nX\n", [b"D #14\n\n\n\n", b"X"]),
        (b"D #210'\"34567890\nX\n", [b"D #210'\"34567890", b"X"]),
        (b"D #0abc\nX\n", [b"D #0abc", b"X"]),
        (b"D #H1F\nX\n", [b"D #H1F", b"X"]),
        (b"D #3xx\nX\n", [b"D #3xx", b"X"]),
        (b"D #\nX\n", [b"D #", b"X"]),
        (b"half", []),
    ],
)
def test_message_ends_at_a_line_feed_outside_quotes_and_blocks(data: bytes, expected: list[bytes]) -> None:
    assert bodies(MessageFramer(), data) == expected


@pytest.mark.parametrize(
    "data", [b"T 'a\nb';D #212\n\n\n\n\n\n\n\n\n\n\n\n;E #H1F\r\nX\n", b"D #10\nX #0''\n'\n'\nX\n"]
)
def test_framing_does_not_depend_on_how_the_bytes_arrive(data: bytes) -> None:
    whole = bodies(MessageFramer(), data)
    framer = MessageFramer()
    assert [body for byte in data for body in bodies(framer, bytes([byte]))] == whole


def test_message_beyond_the_limit_is_dropped_and_the_next_one_heard() -> None:
    framer = MessageFramer(limit_bytes=100)
    messages = framer.feed(b"x" * 60) + framer.feed(b"x" * 60)
    assert messages == []
    assert framer.pending_bytes == 0, "nothing of a message that is too long is kept"
    messages = framer.feed(b"tail\n*IDN?\n")
    assert [(m.body, m.is_overrun) for m in messages] == [(b"", True), (b"*IDN?", False)]


def test_message_beyond_the_limit_in_one_piece_is_dropped_too() -> None:
    messages = MessageFramer(limit_bytes=10).feed(b"x" * 20 + b"\nA\n")
    assert [(m.body, m.is_overrun) for m in messages] == [(b"", True), (b"A", False)]


def test_announced_gigabyte_is_not_waited_for() -> None:
    framer = MessageFramer()
    messages = framer.feed(b"D #9999999999abc\n*IDN?\n")
    assert [(m.body, m.is_overrun) for m in messages] == [(b"", True), (b"*IDN?", False)]


@pytest.mark.parametrize("data", [b"T 'open", b'T "open', b"D #15ab", b"D #3100"])
def test_missing_bytes_close_what_is_open(data: bytes) -> None:
    framer = MessageFramer()
    assert framer.feed(data) == []
    assert framer.state in {FramerState.QUOTED, FramerState.BLOCK}
    assert len(framer.feed(framer.missing + b"\n")) == 1
    assert framer.state is FramerState.PLAIN
