"""Whatever an analyzer sends, it becomes a value or an AnswerError."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.frontend.drivers.scpi import (
    AnswerError,
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

PARSERS: list[Callable[[str], Any]] = [
    parse_identity,
    parse_message,
    parse_number,
    parse_flag,
    split_answers,
    lambda text: levels_of_text(text, 3),
    lambda text: parse_date_time(text, text),
]


@pytest.mark.parametrize("parse", PARSERS)
@given(text=st.one_of(st.text(max_size=60), st.from_regex(r'[-+0-9,;"#.eE ]{0,30}', fullmatch=True)))
def test_text_of_any_kind(parse: Callable[[str], Any], text: str) -> None:
    try:
        value = parse(text)
    except AnswerError:
        return
    assert value is not None


@given(st.one_of(st.binary(max_size=60), st.from_regex(rb"#[0-9(][0-9)]{0,4}[\x00-\xff]{0,20}", fullmatch=True)))
def test_blocks_of_any_kind(data: bytes) -> None:
    try:
        payload, rest = split_block(data)
    except AnswerError:
        return
    assert payload + rest in data + b"\n"


@given(st.lists(st.floats(min_value=-200, max_value=50, width=32), min_size=1, max_size=50), st.binary(max_size=8))
def test_a_real_block_comes_back(levels: list[float], tail: bytes) -> None:
    content = np.array(levels, dtype="<f4").tobytes()
    size = str(len(content)).encode()
    payload, rest = split_block(b"#" + str(len(size)).encode() + size + content + tail)
    assert rest == tail
    np.testing.assert_array_equal(levels_of_block(payload, len(levels)), np.array(levels))


@given(
    st.lists(st.text(alphabet='ab1,. "', max_size=8).filter(lambda t: t.count('"') % 2 == 0), min_size=1, max_size=6)
)
def test_answers_come_apart_where_they_were_joined(answers: list[str]) -> None:
    assert split_answers(";".join(answers)) == [answer.strip() for answer in answers]
