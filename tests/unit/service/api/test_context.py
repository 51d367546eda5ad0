"""Parts of all routes: waiting for the writer's thread, limits of epochs, widths of plans, blocks read ahead."""

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import Future

import numpy as np
import pytest

from service.api.context import CommitWaiter, EpochLimits, Limits, PlanWidths
from service.api.export.export_chunks import AHEAD_BYTES, read_ahead
from service.errors import NotFoundError
from service.records.catalogue import Carrier, CarrierPlan
from service.records.levels.measurement import MeasurementBlock

pytestmark = pytest.mark.anyio


def test_results_and_faults_arrive_with_one_wake_of_the_loop():
    async def run() -> tuple[list[object], int]:
        waiter, loop, wakes = CommitWaiter(), asyncio.get_running_loop(), []
        original = loop.call_soon_threadsafe
        loop.call_soon_threadsafe = lambda *call: wakes.append(1) or original(*call)  # type: ignore[method-assign]
        futures: list[Future[int]] = [Future() for _ in range(5)]
        waiting = asyncio.gather(*map(waiter.of, futures), return_exceptions=True)
        await asyncio.sleep(0)

        def settle() -> None:
            for number, future in enumerate(futures[:-1]):
                future.set_result(number)
            futures[-1].set_exception(ValueError("no"))

        thread = threading.Thread(target=settle)
        thread.start()
        # the loop stands still meanwhile
        thread.join()
        return await waiting, len(wakes)

    answers, wakes = asyncio.run(run())
    assert answers[:-1] == [0, 1, 2, 3]
    assert isinstance(answers[-1], ValueError)
    assert wakes == 1


def test_many_landings_at_any_moment_lose_none():
    async def run() -> list[int]:
        waiter = CommitWaiter()
        futures: list[Future[int]] = [Future() for _ in range(400)]
        thread = threading.Thread(target=lambda: [future.set_result(k) for k, future in enumerate(futures)])
        waiting = asyncio.gather(*map(waiter.of, futures))
        await asyncio.sleep(0)
        thread.start()
        found = await asyncio.wait_for(waiting, 120.0)
        thread.join()
        return found

    assert asyncio.run(run()) == list(range(400))


def test_who_gives_up_does_not_cancel_what_is_under_way():
    async def run() -> Future[int]:
        waiter, future = CommitWaiter(), Future[int]()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(waiter.of(future), 0.01)
        other = asyncio.ensure_future(waiter.of(future))
        await asyncio.sleep(0)
        assert not future.cancelled()
        future.set_result(3)
        assert await other == 3
        return future

    late = asyncio.run(run())
    assert late.result() == 3


def test_a_loop_that_has_ended_is_not_woken():
    future: Future[int] = Future()

    async def give_up() -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(CommitWaiter().of(future), 0.01)

    asyncio.run(give_up())
    future.set_result(1)
    assert future.result() == 1


S = 1_000_000
LAST_FIRST_US = 4_102_444_800 * S  # 2100-01-01
NOW_US = 1_800_000_000 * S
LIMITS = Limits(future_tolerance_s=5.0, future_tolerance_data_s=3600.0, late_after_s=300.0)


class CountingClock:
    """A clock that counts how often it is asked."""

    def __init__(self, *, is_data: bool, newest_us: int | None = None) -> None:
        self.data, self.newest_us, self.system, self.asked = is_data, newest_us, NOW_US, 0

    def system_us(self) -> int:
        return self.system

    def is_data(self, spacecraft_id: str) -> bool:
        self.asked += 1
        return self.data

    def now_us(self, spacecraft_id: str) -> int | None:
        return self.newest_us if self.data else self.system


class Marks:
    """An archive that has dropped what is below a mark."""

    def __init__(self, kept_from_us: int = -1) -> None:
        self.mark_us = kept_from_us

    def kept_from_us(self, spacecraft_id: str, series: str) -> int:
        assert series == "measurements"
        return self.mark_us


def known(limits: EpochLimits):
    return asyncio.run(limits.known("sc"))


def test_the_data_clock_is_asked_once_a_second():
    clock = CountingClock(is_data=True, newest_us=1000 * S)
    limits = EpochLimits(clock, LIMITS, Marks())
    assert [known(limits).latest_us for _ in range(3)] == [4600 * S] * 3
    assert clock.asked == 1
    clock.newest_us, clock.system = 2000 * S, NOW_US + S
    assert known(limits).latest_us == 5600 * S
    assert clock.asked == 2


def test_a_caller_that_would_refuse_gets_the_bounds_of_the_moment():
    clock = CountingClock(is_data=True, newest_us=1000 * S)
    limits = EpochLimits(clock, LIMITS, Marks())
    known(limits)
    clock.newest_us = 2000 * S
    assert asyncio.run(limits.present("sc")).latest_us == 5600 * S
    assert known(limits).latest_us == 5600 * S


def test_before_the_first_row_nothing_is_remembered():
    clock = CountingClock(is_data=True)
    limits = EpochLimits(clock, LIMITS, Marks())
    assert known(limits).latest_us == LAST_FIRST_US
    clock.newest_us = 1000 * S
    assert known(limits).latest_us == 4600 * S


def test_under_the_system_clock_the_bounds_move_with_the_time():
    clock = CountingClock(is_data=False)
    limits = EpochLimits(clock, LIMITS, Marks())
    assert known(limits).latest_us == NOW_US + 5 * S
    clock.system += S // 2
    assert known(limits).latest_us == NOW_US + 5 * S + S // 2
    assert known(limits).stale_before_us == NOW_US - 300 * S + S // 2
    assert clock.asked == 1


def test_a_changed_spacecraft_and_a_clock_set_back_are_asked_about_again():
    clock = CountingClock(is_data=True, newest_us=1000 * S)
    limits = EpochLimits(clock, LIMITS, Marks())
    known(limits)
    clock.data = False
    limits.forget("sc")
    assert known(limits).latest_us == NOW_US + 5 * S
    clock.system = NOW_US - 10 * S
    known(limits)
    assert clock.asked == 3


def test_what_retention_has_dropped_is_too_old():
    marks = Marks()
    limits = EpochLimits(CountingClock(is_data=False), LIMITS, marks)
    before = known(limits).earliest_us
    marks.mark_us = NOW_US - 100 * S
    assert asyncio.run(limits.present("sc")).earliest_us == NOW_US - 100 * S > before


def test_all_that_come_at_once_ask_once_and_a_refusal_asks_for_itself():
    clock = CountingClock(is_data=True, newest_us=1000 * S)
    limits = EpochLimits(clock, LIMITS, Marks())

    async def ask() -> list[int | None]:
        bounds = await asyncio.gather(*(limits.known("sc") for _ in range(20)))
        return [each.latest_us for each in bounds]

    assert asyncio.run(ask()) == [4600 * S] * 20
    assert clock.asked == 1
    asyncio.run(limits.present("sc"))
    assert clock.asked == 2


class CountingCatalogue:
    def __init__(self) -> None:
        self.asked: list[tuple[str, int]] = []

    def plan(self, spacecraft_id, plan_id):
        self.asked.append((spacecraft_id, plan_id))
        if spacecraft_id == "nobody":
            raise NotFoundError("spacecraft.unknown", "no such spacecraft")
        return CarrierPlan(plan_id, "", tuple(Carrier(f"c{k}", "Ku", "t", 1.0, 1.0) for k in range(plan_id)))


async def test_a_plan_is_looked_up_once():
    catalogue = CountingCatalogue()
    widths = PlanWidths(catalogue)
    assert [await widths.width("y", 3) for _ in range(5)] == [3] * 5
    assert catalogue.asked == [("y", 3)]


async def test_what_is_unknown_is_asked_for_again():
    catalogue = CountingCatalogue()
    widths = PlanWidths(catalogue)
    for _ in range(2):
        with pytest.raises(NotFoundError):
            await widths.width("nobody", 1)
    assert len(catalogue.asked) == 2, "the spacecraft may have been added meanwhile"


async def test_memory_is_bounded_and_keeps_what_is_in_use():
    catalogue = CountingCatalogue()
    widths = PlanWidths(catalogue, capacity=2)
    for spacecraft_id in ("a", "b", "a", "c", "a", "b"):
        await widths.width(spacecraft_id, 1)
    assert catalogue.asked == [("a", 1), ("b", 1), ("c", 1), ("b", 1)]


ROWS = AHEAD_BYTES // (4 * 16) // 4


class Source:
    """Gives blocks and remembers how many were taken, and whether it was let go."""

    def __init__(self, count: int, fault: Exception | None = None) -> None:
        self.taken = 0
        self.is_closed = False
        self._count = count
        self._fault = fault

    def blocks(self) -> Iterator[MeasurementBlock]:
        try:
            for number in range(self._count):
                self.taken += 1
                epochs_us = np.arange(ROWS) + number
                yield MeasurementBlock(("sa-1",), 1, epochs_us, np.zeros((ROWS, 16), np.float32))
            if self._fault is not None:
                raise self._fault
        finally:
            self.is_closed = True


def running() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "read-ahead"]


@pytest.mark.parametrize("count", [0, 1, 30])
def test_all_blocks_come_in_order(count):
    source = Source(count)
    assert [int(block.epochs_us[0]) for block in read_ahead(source.blocks())] == list(range(count))
    assert not running()


def test_what_waits_is_bounded():
    source = Source(30)
    blocks = read_ahead(source.blocks())
    for given in range(1, 7):
        next(blocks)
        # four blocks fill the line, one more may have been read that waits for room
        assert source.taken <= given + 5
    blocks.close()


def test_what_reading_raised_comes_after_the_blocks_before_it():
    blocks = read_ahead(Source(2, fault=ValueError("damaged")).blocks())
    assert len([next(blocks), next(blocks)]) == 2
    with pytest.raises(ValueError, match="damaged"):
        next(blocks)
    assert not running()


def test_a_reader_that_goes_ends_the_thread():
    source = Source(30)
    blocks = read_ahead(source.blocks())
    next(blocks)
    blocks.close()
    assert not running()
    assert source.is_closed
    assert source.taken < 30
