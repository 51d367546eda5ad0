"""State of a HiSLIP session: the table, gathering, interruption, status."""

import pytest

from analyzer_sim.lines.hislip_messages import ErrorCode, FatalCode, FatalProtocolError, Message, MessageType
from analyzer_sim.lines.hislip_session import (
    SYNCHRONOUS,
    TRANSITIONS,
    HislipSession,
    Phase,
    RefusedMessageError,
    programs_of,
)
from analyzer_sim.scpi.framing import MESSAGE_LIMIT_BYTES

M = MessageType
FIRST_ID = 0xFFFFFF00


def message(kind: int, payload: bytes = b"", *, number: int = FIRST_ID, control: int = 0, big: bool = False) -> Message:
    return Message(kind, control, number, payload, is_oversize=big)


@pytest.fixture
def session() -> HislipSession:
    made = HislipSession(1, 0x0100)
    made.step(message(M.ASYNC_INITIALIZE), is_synchronous=False)
    return made


@pytest.mark.parametrize(("client", "agreed"), [(0x0100, 0x0100), (0x0101, 0x0101), (0x0200, 0x0101)])
def test_the_older_version_is_agreed(client: int, agreed: int) -> None:
    assert HislipSession(1, client).version == agreed


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize("kind", [*M, 26, 38, 127, 128, 255])
@pytest.mark.parametrize("is_synchronous", [True, False])
def test_every_message_in_every_phase_has_its_row_or_its_refusal(phase: Phase, kind: int, is_synchronous: bool) -> None:
    made = HislipSession(1, 0x0100)
    made.phase = phase
    is_right_channel = kind in {M.ERROR, M.FATAL_ERROR} or (kind in SYNCHRONOUS) == is_synchronous
    if (phase, kind) in TRANSITIONS and is_right_channel:
        made.step(message(kind), is_synchronous=is_synchronous)
        assert made.phase is TRANSITIONS[phase, kind]
    elif kind in {M.INITIALIZE, M.ASYNC_INITIALIZE}:
        with pytest.raises(FatalProtocolError) as fatal:
            made.step(message(kind), is_synchronous=is_synchronous)
        assert fatal.value.code is FatalCode.INVALID_INITIALIZATION
    elif phase is Phase.HALF_OPEN:
        with pytest.raises(FatalProtocolError) as fatal:
            made.step(message(kind), is_synchronous=is_synchronous)
        assert fatal.value.code is FatalCode.CHANNELS_INCOMPLETE
    else:
        with pytest.raises(RefusedMessageError) as refused:
            made.step(message(kind), is_synchronous=is_synchronous)
        assert refused.value.code is (ErrorCode.UNKNOWN_VENDOR_MESSAGE if kind >= 128 else ErrorCode.UNKNOWN_TYPE)
        assert made.phase is phase


def test_parts_are_gathered_until_the_end(session: HislipSession) -> None:
    assert session.gather(message(M.DATA, b"*ID")) is None
    request = session.gather(message(M.DATA_END, b"N?\n", number=FIRST_ID + 2, control=1))
    assert request is not None
    assert [program.body for program in request.programs] == [b"*IDN?"]
    assert (request.message_id, request.is_delivered) == (FIRST_ID + 2, True)


@pytest.mark.parametrize(
    ("data", "bodies"),
    [
        (b"", []),
        (b"*IDN?", [b"*IDN?"]),
        (b"*CLS\r\n*IDN?\n", [b"*CLS", b"*IDN?"]),
        (b"DISP:TEXT 'a\nb", [b"DISP:TEXT 'a\nb"]),
        (b"X #15ab\ncd\n", [b"X #15ab\ncd"]),
        (b"X #19ab", [b"X #19ab"]),
    ],
)
def test_the_end_of_a_message_ends_its_last_program_message(data: bytes, bodies: list[bytes]) -> None:
    assert [program.body for program in programs_of(data)] == bodies


def test_announced_block_beyond_the_limit_is_an_overrun() -> None:
    assert [program.is_overrun for program in programs_of(b"X #9999999999ab")] == [True]


def test_message_beyond_the_limit_is_an_overrun_and_the_next_one_is_not(session: HislipSession) -> None:
    half = b"x" * (MESSAGE_LIMIT_BYTES // 2 + 1)
    for _ in range(2):
        session.gather(message(M.DATA, half))
    request = session.gather(message(M.DATA_END, b"tail"))
    assert request is not None
    assert [program.is_overrun for program in request.programs] == [True]
    request = session.gather(message(M.DATA_END, b"*IDN?"))
    assert request is not None
    assert [program.body for program in request.programs] == [b"*IDN?"]


def test_oversize_part_spoils_its_message_only(session: HislipSession) -> None:
    session.gather(message(M.DATA, b"*IDN"))
    with pytest.raises(RefusedMessageError) as refused:
        session.step(message(M.DATA, big=True), is_synchronous=True)
    assert refused.value.code is ErrorCode.MESSAGE_TOO_LARGE
    assert session.gather(message(M.DATA_END, b"?")) is None
    assert session.gather(message(M.DATA_END, b"*CLS")) is not None


def test_device_clear_drops_everything_until_it_is_complete(session: HislipSession) -> None:
    session.gather(message(M.DATA, b"*ID"))
    session.is_unread = True
    session.step(message(M.ASYNC_DEVICE_CLEAR), is_synchronous=False)
    assert not session.is_unread
    assert session.gather(message(M.DATA_END, b"N?")) is None
    assert session.gather(message(M.TRIGGER)) is None
    session.step(message(M.DEVICE_CLEAR_COMPLETE), is_synchronous=True)
    request = session.gather(message(M.DATA_END, b"*OPC?"))
    assert request is not None
    assert [program.body for program in request.programs] == [b"*OPC?"]


def test_interruption_is_told_once_and_never_after_delivery(session: HislipSession) -> None:
    asked = session.gather(message(M.DATA_END, b"*CLS"))
    reported = session.gather(message(M.TRIGGER, control=1))
    assert asked is not None
    assert reported is not None
    session.is_unread = True
    assert session.is_interrupted_by(asked)
    assert not session.is_interrupted_by(asked)
    session.is_unread = True
    assert not session.is_interrupted_by(reported)
    session.is_unread = True
    session.on_delivery(message(M.ASYNC_STATUS_QUERY, control=1))
    assert not session.is_interrupted_by(asked)


def test_each_new_reason_requests_service_and_a_poll_spends_it(session: HislipSession) -> None:
    assert not session.is_service_wanted(0x04, 0)
    assert session.is_service_wanted(0x44, 0x24)
    assert not session.is_service_wanted(0x44, 0x24)
    assert session.is_service_wanted(0x64, 0x24), "a second reason is a second request"
    assert session.polled(0x64) == 0x64
    assert session.polled(0x64) == 0x24, "bit 6 of a poll tells a request, not a summary"
    assert not session.is_service_wanted(0, 0x24)
    assert session.is_service_wanted(0x44, 0x24)


def test_identifiers_count_up_and_wrap_around(session: HislipSession) -> None:
    assert session.has_taken(FIRST_ID - 2), "nothing sent is nothing to wait for"
    assert not session.has_taken(FIRST_ID)
    session.gather(message(M.TRIGGER, number=0xFFFFFFFE))
    assert session.has_taken(FIRST_ID)
    assert not session.has_taken(2)
    session.gather(message(M.TRIGGER, number=2))
    assert session.has_taken(0xFFFFFFFE)
