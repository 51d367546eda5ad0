"""Answers of analyzers as they come, good and bad."""

import struct

import numpy as np
import pytest

from service.frontend.drivers.scpi import (
    AnalyzerMessage,
    AnswerError,
    block_length,
    levels_of_block,
    levels_of_text,
    parse_date_time,
    parse_flag,
    parse_identity,
    parse_message,
    parse_number,
    split_answers,
    split_block,
)


def test_a_block_may_hold_line_feeds() -> None:
    values = np.full(64, np.frombuffer(b"\n\n\n\n", dtype="<f4")[0])
    payload = values.astype("<f4").tobytes()
    header = b"#3256"
    assert split_block(header + payload + b';0,"No error"') == (payload, b';0,"No error"')


@pytest.mark.parametrize(
    "data",
    [b"", b"#", b"#x", b"#1", b"#24", b"#29\n", b"#15abcd", b"#2x1a", b"#9123", b"#(12", b"#(9)ab", b"1,2"],
)
def test_a_block_that_does_not_fit_is_refused(data: bytes) -> None:
    with pytest.raises(AnswerError):
        split_block(data)


def test_large_and_indefinite_blocks() -> None:
    assert split_block(b"#(3)abc;1") == (b"abc", b";1")
    assert split_block(b"#0abc\n") == (b"abc", b"")
    assert block_length(b"#4") == 4


def test_byte_order_of_a_real_trace() -> None:
    little = struct.pack("<3f", -42.5, 9.91e37, -999.0)
    levels = levels_of_block(little, 3)
    assert levels[0] == pytest.approx(-42.5, abs=0.0)  # representable in float32
    assert np.isnan(levels[1:]).all()
    big = levels_of_block(struct.pack(">1f", -42.5), 1, is_big_endian=True)
    assert big[0] == pytest.approx(-42.5, abs=0.0)


def test_a_trace_of_another_length_is_refused() -> None:
    with pytest.raises(AnswerError, match="3 points"):
        levels_of_block(b"\0" * 8, 3)
    with pytest.raises(AnswerError, match="2 values where 3"):
        levels_of_text("1,2", 3)


@pytest.mark.parametrize("text", ["-1.0,-2.5E+01", "-1.0,-2.5E+01,", "#A213-1.0,-2.5E+01\r\n", " -1.0 , -25 "])
def test_ascii_traces_of_several_makers(text: str) -> None:
    np.testing.assert_allclose(levels_of_text(text, 2), [-1.0, -25.0], atol=0.0)  # short decimals, exact in float64


def test_garbage_in_an_ascii_trace_is_refused() -> None:
    with pytest.raises(AnswerError, match="not a number"):
        levels_of_text("1,two", 2)


def test_messages_of_the_error_queue() -> None:
    assert parse_message('+0,"No error"').code == 0
    assert parse_message('-113,"Undefined ""header"";X"') == AnalyzerMessage(-113, 'Undefined "header";X')
    assert parse_message("-222,out of range").text == "out of range"
    with pytest.raises(AnswerError):
        parse_message("no error")


@pytest.mark.parametrize(
    ("code", "is_execution", "is_command"),
    [(-200, True, False), (-222, False, False), (-113, False, True), (-350, False, False), (-410, False, True)],
)
def test_which_messages_refuse(code: int, is_execution: bool, is_command: bool) -> None:
    message = AnalyzerMessage(code, "")
    assert (message.is_execution_error, message.is_command_error) == (is_execution, is_command)


def test_answers_are_cut_outside_quotes() -> None:
    assert split_answers('"a;b";2;') == ['"a;b"', "2", ""]


def test_numbers_and_flags() -> None:
    assert parse_number("9.91E37") != parse_number("9.91E37")  # NaN is not itself
    assert parse_flag("ON")
    assert not parse_flag("0")
    with pytest.raises(AnswerError):
        parse_number("fast")
    with pytest.raises(AnswerError):
        parse_flag("maybe")


def test_identity_of_four_and_of_more_fields() -> None:
    identity = parse_identity("Siglent Technologies,SSA3032X,SSA3X1,1.2.9.3,extra\n")
    assert (identity.vendor, identity.firmware) == ("Siglent Technologies", "1.2.9.3,extra")
    assert parse_identity("Maker,Model").serial == ""
    with pytest.raises(AnswerError):
        parse_identity("1")


def test_date_and_time() -> None:
    assert parse_date_time("2026,1,2", "3,4,5.25") == "2026-01-02T03:04:05.25Z"
    with pytest.raises(AnswerError):
        parse_date_time("today", "3,4,5")
