"""Clocks: the system's for real spacecraft, the newest epoch for simulated ones."""

import time

import pytest

from service.runtime.clock import DataClock, SystemClock, system_now_us


def test_the_system_clock_is_utc_in_microseconds_for_everybody():
    clock = SystemClock()
    before = time.time_ns() // 1000
    found = [clock.now_us("a"), clock.system_us(), system_now_us()]
    after = time.time_ns() // 1000
    assert all(before <= now_us <= after for now_us in found)
    assert not clock.is_data("a")


@pytest.mark.parametrize("newest_us", [None, 17])
def test_the_data_clock_is_the_newest_epoch_of_a_simulated_spacecraft(newest_us):
    clock = DataClock({"simulated": True, "real": False}.__getitem__, {"simulated": newest_us}.get)
    assert clock.now_us("simulated") == newest_us
    assert clock.is_data("simulated")
    assert not clock.is_data("real")
    assert abs(clock.now_us("real") - clock.system_us()) < 10_000_000  # the same clock, read within ten seconds
