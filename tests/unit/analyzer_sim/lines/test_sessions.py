"""Sessions without a socket: one client's dialogue, many clients on one instrument, faults of a line."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest
from standing_source import StandingSource

from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.models import FSW_26
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.sweep_progress import Pace, SweepProgress
from analyzer_sim.lines.dispatcher import Dispatcher
from analyzer_sim.lines.line_faults import LineFault, LineFaults
from analyzer_sim.lines.session import Session
from analyzer_sim.scpi.framing import ProgramMessage

pytestmark = pytest.mark.anyio
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
