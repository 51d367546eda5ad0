"""Jumps of the clock are flagged and counted in either direction; an even clock never is."""

import logging

import pytest

from service.frontend.acquisition.epoch_guard import SETTLE_S, EpochGuard
from service.records.levels.quality_flag import QualityFlag

START_US = 1_795_230_152_000_000


def flags(jump_s: float, rows: int = 20, period_s: float = 5.0, drift: float = 0.0) -> tuple[EpochGuard, list[bool]]:
    """Return what is said of rows of which the fifth comes after a jump."""
    guard = EpochGuard(has_monotonic=True)
    reported = []
    for k in range(rows):
        epoch_us = START_US + round(1e6 * (period_s * k * (1 + drift) + (jump_s if k >= 5 else 0.0)))
        reported.append(bool(guard.judge(epoch_us, 100.0 + period_s * k) & QualityFlag.CLOCK_UNSYNC))
    return guard, reported


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 1.0, -1.0])
def test_a_jump_is_flagged_until_the_clock_has_been_even_for_a_minute(
    jump_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    guard, reported = flags(jump_s)
    assert reported == [5 <= k < 5 + SETTLE_S / 5.0 for k in range(20)]
    assert guard.jumps == 1
    assert f"went {'forward' if jump_s > 0 else 'back'} by {abs(jump_s):.3f} s" in caplog.text
    assert guard.warning == ""


@pytest.mark.parametrize("drift", [0.0, 200e-6, -500e-6])
def test_an_even_clock_is_trusted(drift: float) -> None:
    guard, reported = flags(0.0, drift=drift)
    assert not any(reported)
    assert guard.jumps == 0


def test_long_periods_of_a_slewed_clock_are_no_jump() -> None:
    guard, reported = flags(0.0, period_s=3600.0, drift=400e-6)
    assert not any(reported)
    assert guard.jumps == 0


def test_of_an_analyzers_calendar_only_the_way_back_is_seen() -> None:
    guard = EpochGuard(has_monotonic=False)
    epochs = [0, 60_000_000, 7_200_000_000, 7_200_000_000, 1_000_000]
    assert [bool(guard.judge(START_US + each, 0.01 * k)) for k, each in enumerate(epochs)] == [
        False,
        False,
        False,
        True,
        True,
    ]
