"""Bytes of a HiSLIP channel: cutting, limits, answers in parts."""

import itertools
import struct

import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer_sim.lines.hislip_messages import (
    HEADER,
    MAX_PAYLOAD_BYTES,
    Decoder,
    FatalCode,
    FatalProtocolError,
    Message,
    MessageType,
    answer_parts,
    decode_size,
    encode,
    encode_size,
)


def test_header_is_that_of_the_standard() -> None:
    # IVI-6.1, 2.5: "HS", type, control, parameter, length, all big-endian
    assert (
        encode(MessageType.DATA_END, 1, 0xFFFFFF00, b"*IDN?\n")
        == bytes.fromhex("4853 07 01 ffffff00 0000000000000006") + b"*IDN?\n"
    )
    assert [kind.value for kind in MessageType] == list(range(26))


@given(
    messages=st.lists(
        st.tuples(
            st.sampled_from(list(MessageType)), st.integers(0, 255), st.integers(0, 2**32 - 1), st.binary(max_size=40)
        ),
        max_size=6,
    ),
    cuts=st.lists(st.integers(0, 400), max_size=6),
)
@settings(max_examples=examples(200), deadline=None, derandomize=True)
def test_messages_do_not_depend_on_how_the_bytes_arrive(messages: list, cuts: list[int]) -> None:
    data = b"".join(encode(*message) for message in messages)
    decoder = Decoder()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    got = [message for left, right in itertools.pairwise(edges) for message in decoder.feed(data[left:right])]
    assert got == [Message(*message) for message in messages]
    assert decoder.pending_bytes == 0


@given(data=st.binary(max_size=200))
@settings(max_examples=examples(500), deadline=None, derandomize=True)
def test_any_bytes_are_messages_or_end_the_channel(data: bytes) -> None:
    try:
        given_messages, code = list(Decoder().feed(data)), None
    except FatalProtocolError as error:
        given_messages, code = [], error.code
    assert all(isinstance(message, Message) for message in given_messages)
    # the only thing to complain of is a header that is none, and a right beginning is not complained of
    assert code is None or (code is FatalCode.POORLY_FORMED_HEADER and data)


def test_messages_before_garbage_are_given() -> None:
    messages = Decoder().feed(encode(MessageType.TRIGGER) + b"GET / HTTP/1.1\r\n")
    assert next(messages).kind == MessageType.TRIGGER
    with pytest.raises(FatalProtocolError):
        next(messages)


def test_first_wrong_byte_is_enough() -> None:
    with pytest.raises(FatalProtocolError):
        list(Decoder().feed(b"X"))
    assert list(Decoder().feed(b"H")) == []


def test_payload_above_the_limit_is_skipped_and_never_held() -> None:
    decoder = Decoder(limit_bytes=100)
    data = encode(MessageType.DATA, 0, 5, b"x" * 5000) + encode(MessageType.TRIGGER)
    got, most = [], 0
    for start in range(0, len(data), 64):
        got += decoder.feed(data[start : start + 64])
        most = max(most, decoder.pending_bytes)
    assert got == [Message(MessageType.DATA, 0, 5, b"", is_oversize=True), Message(MessageType.TRIGGER, 0, 0, b"")]
    assert most < 100


def test_length_beyond_all_sense_ends_the_channel() -> None:
    with pytest.raises(FatalProtocolError):
        list(Decoder().feed(HEADER.pack(b"HS", 7, 0, 0, 2**63)))
    assert list(Decoder().feed(HEADER.pack(b"HS", 7, 0, 0, MAX_PAYLOAD_BYTES + 1))) == []


@pytest.mark.parametrize("size", [1, 31, 32, 33, 100, 1000])
@pytest.mark.parametrize("client_bytes", [0, 16, 32, 48, 2**64 - 1])
def test_parts_add_up_and_only_the_last_ends(size: int, client_bytes: int) -> None:
    answer = bytes(range(256)) * 4
    parts = [message for part in answer_parts(answer[:size], 8, client_bytes) for message in Decoder().feed(part)]
    assert b"".join(part.payload for part in parts) == answer[:size]
    assert [part.kind for part in parts] == [MessageType.DATA] * (len(parts) - 1) + [MessageType.DATA_END]
    assert {part.parameter for part in parts} == {8}
    assert all(0 < len(part.payload) <= max(16, client_bytes - 16) for part in parts)


def test_size_has_eight_bytes() -> None:
    assert decode_size(encode_size(2**40)) == 2**40
    assert decode_size(struct.pack("!I", 5)) is None
