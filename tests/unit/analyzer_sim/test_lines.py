"""HiSLIP and sessions without a socket: bytes of a channel, locks, one client's dialogue, faults of a line."""

import asyncio
import itertools
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_source import StandingSource

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.instrument_settings import FSW_26
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress
from analyzer_sim.lines.dispatcher import Dispatcher, Session
from analyzer_sim.lines.hislip_session import (
    HEADER,
    MAX_PAYLOAD_BYTES,
    SYNCHRONOUS,
    TRANSITIONS,
    Decoder,
    ErrorCode,
    FatalCode,
    FatalProtocolError,
    HislipSession,
    LockAnswer,
    LockTable,
    Message,
    MessageType,
    Phase,
    RefusedMessageError,
    answer_parts,
    decode_size,
    encode,
    encode_size,
    programs_of,
)
from analyzer_sim.lines.line_faults import LineFault, LineFaults
from analyzer_sim.scpi.framing import MESSAGE_LIMIT_BYTES, ProgramMessage

pytestmark = pytest.mark.anyio


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


def test_exclusive_lock_keeps_everybody_else_out() -> None:
    table = LockTable()
    assert table.request("a", "") is LockAnswer.SUCCESS
    assert (table.may_run("a"), table.may_run("b"), table.is_exclusive, table.holders) == (True, False, True, 1)
    assert table.request("b", "") is None
    assert table.request("b", "key") is None
    assert table.release("b") is LockAnswer.INVALID
    assert table.release("a") is LockAnswer.SUCCESS
    assert table.may_run("b")
    assert table.release("a") is LockAnswer.INVALID


def test_shared_lock_is_had_by_all_who_know_the_key() -> None:
    table = LockTable()
    assert table.request("a", "key") is LockAnswer.SUCCESS
    assert table.request("b", "key") is LockAnswer.SUCCESS
    assert table.request("c", "other") is None
    assert table.request("c", "") is None
    assert [table.may_run(client) for client in "abc"] == [True, True, False]
    assert (table.is_exclusive, table.holders) == (False, 2)
    assert table.release("a") is LockAnswer.SUCCESS_SHARED
    assert table.release("b") is LockAnswer.SUCCESS_SHARED
    assert table.request("c", "other") is LockAnswer.SUCCESS


def test_one_who_shares_may_have_the_exclusive_lock_on_top_and_gives_it_back_first() -> None:
    table = LockTable()
    table.request("a", "key")
    table.request("b", "key")
    assert table.request("a", "") is LockAnswer.SUCCESS
    assert [table.may_run(client) for client in "ab"] == [True, False]
    assert (table.is_exclusive, table.holders) == (True, 2)
    assert table.release("a") is LockAnswer.SUCCESS
    assert table.may_run("b")
    assert table.release("a") is LockAnswer.SUCCESS_SHARED


def test_a_lock_asked_for_twice_is_invalid() -> None:
    table = LockTable()
    table.request("a", "")
    assert table.request("a", "") is LockAnswer.INVALID
    assert table.request("a", "key") is LockAnswer.SUCCESS
    assert table.request("a", "key") is LockAnswer.INVALID


def test_a_client_that_leaves_holds_nothing() -> None:
    table = LockTable()
    table.request("a", "key")
    table.request("a", "")
    table.drop("a")
    table.drop("b")
    assert (table.holders, table.may_run("b"), table.request("b", "other")) == (0, True, LockAnswer.SUCCESS)


MAX_WAIT_S = 120.0


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


def test_device_clear_drops_what_is_held_and_what_waits(bench: Any) -> None:
    bench.allow(False)
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


class Party:
    """A dispatcher and a way to ask it."""

    def __init__(self, rows: int = 1000, **instrument: Any) -> None:
        self.allowed = asyncio.Event()
        self.instrument = Instrument(StandingSource(rows), TracePainter(1, IDEAL), self.allowed.is_set, **instrument)
        self.dispatcher = Dispatcher(self.instrument, RS, self.permission)

    async def permission(self) -> None:
        await self.allowed.wait()

    async def ask(self, session: Session, text: str) -> str:
        response = await self.dispatcher.execute(session, ProgramMessage(text.encode(), is_overrun=False))
        return (response or b"").decode().removesuffix("\n")

    def asking(self, session: Session, text: str) -> "asyncio.Task[str]":
        return asyncio.create_task(self.ask(session, text))


@asynccontextmanager
async def two_sessions(**options: Any) -> AsyncIterator[tuple[Party, Session, Session]]:
    """Open two sessions on one instrument; close the dispatcher."""
    party = Party(**options)
    first, second = party.dispatcher.new_session("socket"), party.dispatcher.new_session("socket")
    async with asyncio.timeout(MAX_WAIT_S):
        yield party, first, second
    await party.dispatcher.close()


async def settled(task: "asyncio.Task[str]") -> bool:
    """Give a task every chance to end, and tell whether it did."""
    for _ in range(20):
        await asyncio.sleep(0)
    return task.done()


async def test_a_held_session_goes_on_when_its_row_is_allowed() -> None:
    async with two_sessions() as (party, first, second):
        held = party.asking(first, "INIT:CONT OFF;:INIT;*OPC?")
        assert not await settled(held)
        assert await party.ask(second, "STAT:OPER:COND?") == "32"
        party.allowed.set()
        assert await held == "1"


async def test_abort_of_another_frees_the_one_that_is_held() -> None:
    async with two_sessions() as (party, first, second):
        held = party.asking(first, "INIT:CONT OFF;:INIT;*OPC?")
        assert not await settled(held)
        assert await party.ask(second, "ABOR") == ""
        assert await held == "1"


async def test_a_locked_out_session_starts_when_the_lock_is_given_back() -> None:
    async with two_sessions() as (party, first, second):
        party.dispatcher.locks.request(first, "")
        waiting = party.asking(second, "*ESE 3;*ESE?")
        assert not await settled(waiting)
        assert await party.ask(first, "*ESE?") == "0"
        party.dispatcher.leave(first)
        assert await waiting == "3"


async def test_watchers_see_the_end_of_a_sweep_that_nobody_asks_about() -> None:
    async with two_sessions() as (party, first, _second):
        seen: list[int] = []
        party.dispatcher.watchers.add(lambda: seen.append(party.instrument.status.event & 1))
        await party.ask(first, "INIT:CONT OFF;:INIT;*OPC")
        assert seen[-1] == 0
        party.allowed.set()
        while not seen[-1]:
            await asyncio.sleep(0)


async def test_a_short_sweep_does_not_wait_for_the_long_one_that_was_aborted() -> None:
    async with two_sessions(progress=SweepProgress(Pace.REAL)) as (party, first, second):
        party.allowed.set()
        held = party.asking(first, "INIT:CONT OFF;:SWE:TIME 1000;:INIT;*OPC?")
        assert not await settled(held)
        await party.ask(second, "ABOR;:SWE:TIME 0.02;:INIT")
        assert await held == "1"
        assert await party.ask(second, "*OPC?") == "1"


async def test_the_first_of_endless_sweeps_wakes_who_waits_for_it() -> None:
    async with two_sessions(progress=SweepProgress(Pace.REAL)) as (party, first, second):
        await party.ask(first, "INIT:CONT OFF;:SWE:POIN 201;TIME 1;:INIT:CONT ON")
        traces = [party.asking(session, "TRAC? TRACE1") for session in (first, second)]
        assert not await settled(traces[0])
        assert {(await trace).count(",") for trace in traces} == {200}


async def test_a_sweep_that_is_over_before_anybody_looks_wakes_who_waits_for_it() -> None:
    reads = itertools.count()

    async with two_sessions(progress=SweepProgress(Pace.REAL, lambda: 0.0006 * next(reads))) as (party, first, second):
        for session in (first, second):
            trace = party.asking(session, "INIT:CONT OFF;:SWE:POIN 201;TIME 0.001;:INIT:CONT ON;:TRAC? TRACE1")
            assert (await trace).count(",") == 200

    # six tenths of the sweep pass from one look at the clock to the next


async def test_the_end_of_the_scenario_is_told_to_the_session_that_asked() -> None:
    async with two_sessions(rows=0, model=replace(FSW_26, is_error_queue_per_session=True)) as (party, first, second):
        held = party.asking(first, "INIT:CONT OFF;:INIT;*OPC?")
        assert not await settled(held)
        assert await party.ask(second, "*ESE?") == "0"
        party.allowed.set()
        assert await held == "1"
        assert (await party.ask(second, "SYST:ERR?")).startswith("0,")
        assert (await party.ask(first, "SYST:ERR?")).startswith("-200,")


def test_fault_that_needs_a_block_waits_for_one() -> None:
    faults = LineFaults()
    faults.arm(LineFault.HALF_BLOCK)
    faults.arm(LineFault.RESET)
    assert faults.consume(b"1\n") is None
    assert faults.consume(b"#11a\n") is LineFault.HALF_BLOCK
    assert faults.consume(b"1\n") is LineFault.RESET
    assert faults.consume(b"1\n") is None


def test_a_silent_peer_is_silent_until_disarmed_and_spends_nothing() -> None:
    faults = LineFaults()
    faults.arm(LineFault.STALE)
    faults.is_silent_peer = True
    assert [faults.consume(b"1\n") for _ in range(3)] == [LineFault.SILENT] * 3
    assert faults.remaining == 1
    faults.is_silent_peer = False
    assert faults.consume(b"1\n") is LineFault.STALE
    faults.is_silent_peer = True
    faults.disarm()
    assert faults.consume(b"1\n") is None


def test_disarmed_faults_do_nothing() -> None:
    faults = LineFaults()
    faults.arm(LineFault.SILENT, times=3)
    assert faults.remaining == 3
    faults.disarm()
    assert faults.consume(b"1\n") is None
