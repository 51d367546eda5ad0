"""Windows that readings of a sensor show: turns with the quiet days before and the hour after them, or why not."""

from functools import cache

import numpy as np
import pytest
from foreign_station import flown
from hypothesis import given
from hypothesis import strategies as st

from service.pipeline.config import CalibrationConfig
from service.pipeline.planning.flown_turns import FlownWindows, flown_windows

MINUTE_US, DAY_MIN = 60_000_000, 1440
CONFIG = CalibrationConfig()


@cache
def readings() -> tuple[np.ndarray, np.ndarray]:
    """Return epochs and angles of quiet days, turns and hours after them, with the noise of a sensor."""
    known = list(flown())
    angles_deg = np.array([angles for _, angles in known])
    epochs_us = np.array([round(epoch.timestamp() * 1e6) for epoch, _ in known])
    return epochs_us, angles_deg + np.random.default_rng(3).normal(0.0, 0.005, angles_deg.shape)


def minutes(found: FlownWindows, name: str) -> tuple[float, float]:
    """Return a window in minutes since the first reading."""
    window = getattr(found, name)
    first_us = int(readings()[0][0])
    return (window.start_us - first_us) / MINUTE_US, (window.stop_us - first_us) / MINUTE_US


def test_turns_are_found_with_the_days_before_and_the_hour_after() -> None:
    found = flown_windows(*readings(), CONFIG)
    assert found.shortcomings == ()
    start, stop = minutes(found, "turns")
    # 6 staircases of 64 min, 8 corners of 12 min and a rest of 10 min
    assert 3 * DAY_MIN - 30 < start <= 3 * DAY_MIN
    assert 3 * DAY_MIN + 480 <= stop < 3 * DAY_MIN + 520
    assert minutes(found, "quiet") == (0.0, start)
    assert minutes(found, "align") == (stop, stop + 60)


@given(st.floats(0.0, 0.5), st.integers(0, 2))
def test_a_constant_of_the_sensor_and_absent_readings_move_no_window(offset_deg: float, axis: int) -> None:
    epochs_us, angles_deg = readings()
    changed = angles_deg[::3].copy()
    changed[:, axis] += offset_deg / 10
    changed[::7] = np.nan
    found = flown_windows(epochs_us[::3], changed, CONFIG)
    start, _ = minutes(found, "turns")
    assert abs(start - 3 * DAY_MIN) <= 30


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_was_not_turned_is_named(axis: int) -> None:
    epochs_us, angles_deg = readings()
    changed = angles_deg.copy()
    changed[:, axis] = np.clip(changed[:, axis], -1.0, 0.09)
    found = flown_windows(epochs_us, changed, CONFIG)
    assert (found.quiet, found.turns, found.align) == (None, None, None)
    assert f"lack +{('yaw', 'roll', 'pitch')[axis]}" in found.shortcomings[0]


def test_quiet_days_alone_show_no_turns() -> None:
    epochs_us, angles_deg = readings()
    found = flown_windows(epochs_us[: 3 * DAY_MIN], angles_deg[: 3 * DAY_MIN], CONFIG)
    assert found == (None, None, None, ("no turns about all three axes to both sides",))


def test_too_few_readings_before_and_after_the_turns_are_said() -> None:
    epochs_us, angles_deg = readings()
    part = slice(2 * DAY_MIN + 300, 3 * DAY_MIN + 490)
    found = flown_windows(epochs_us[part], angles_deg[part], CONFIG)
    assert found.turns is not None
    assert (found.quiet, found.align) == (None, None)
    assert "less than a day of readings without motion" in found.shortcomings[0]
    assert "no readings in the hour after the turns" in found.shortcomings[1]
    part = slice(3 * DAY_MIN, None)
    assert "less than a day of readings" in flown_windows(epochs_us[part], angles_deg[part], CONFIG).shortcomings[0]


def test_the_last_turns_count_and_the_quiet_days_begin_after_those_before() -> None:
    epochs_us, angles_deg = readings()
    length_us = epochs_us[-1] - epochs_us[0] + MINUTE_US
    twice = flown_windows(np.r_[epochs_us, epochs_us + length_us], np.vstack([angles_deg, angles_deg]), CONFIG)
    once = flown_windows(epochs_us, angles_deg, CONFIG)
    assert twice.turns is not None
    assert once.turns is not None
    assert twice.turns.start_us == once.turns.start_us + length_us
    assert minutes(twice, "quiet")[0] == minutes(once, "turns")[1]
