"""Waiting for another thread: results and faults arrive, the loop is woken once for all that land together."""

import asyncio
import threading
from concurrent.futures import Future

import pytest

from service.api.context.commit_waiter import CommitWaiter


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
