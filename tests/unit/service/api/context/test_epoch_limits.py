"""Epoch limits: what the clock said is remembered for a second, and never makes a row fit that does not."""

import asyncio

from service.api.context.dependencies import Limits
from service.api.context.epoch_limits import EpochLimits

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
