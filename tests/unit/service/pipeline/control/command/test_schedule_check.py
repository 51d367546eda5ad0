"""Verdicts of flexible modes on schedules: what swings is carried from one schedule to the next."""

from dataclasses import replace

import numpy as np
import pytest

from service.core.flexible.schedule.schedule_check import analyse_schedule
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.schedule_check import PanelSwing, schedule_verdict, swing_after
from service.records.catalogue import FlexibleMode
from service.records.levels.attitude import Axes
from service.records.levels.command import Pulse

S = 1_000_000
EPOCH = 1_800_000_000 * S
MODES = (FlexibleMode("pitch", 0.3, 0.003, 0.4), FlexibleMode("roll", 0.6, 0.003, 0.4))


def roll(at_s, torque_n_m=0.02, duration_s=1.0):
    return Pulse(EPOCH + round(at_s * S), duration_s, Axes(0.0, torque_n_m, 0.0))


@pytest.fixture
def record(payload):
    return replace(payload.spacecraft(), modes=MODES)


def test_the_verdict_is_that_of_the_analysis_of_the_axis(record):
    reported = schedule_verdict((roll(10.0), roll(40.0)), record, TorqueConfig())
    (inertia,) = {record.inertia_kg_m2[0][0]}
    own = analyse_schedule(
        pulses=((0.0, 1.0, 0.02), (30.0, 1.0, 0.02)),
        inertia_kg_m2=inertia,
        modes=((0.6, 0.003, 0.4),),
        peak_allowed_rad=np.radians(TorqueConfig().panel_peak_limit_deg),
    )
    assert (reported.verdict, reported.worst_mode) == (own.verdict, 1)
    assert reported.peak_deg == pytest.approx(np.degrees(own.peak_rad), rel=1e-12)
    assert reported.residual_deg == pytest.approx(np.degrees(own.residual_rad), rel=1e-12)


def test_without_modes_or_pulses_there_is_none(record):
    assert schedule_verdict((roll(0.0),), replace(record, modes=()), TorqueConfig()) is None
    assert schedule_verdict((), record, TorqueConfig()) is None
    assert swing_after(None, (roll(0.0),), replace(record, modes=())) is None


def test_what_one_schedule_leaves_counts_for_the_next_and_fades(record):
    alone = schedule_verdict((roll(100.0),), record, TorqueConfig())
    swing = swing_after(None, (roll(0.0),), record)
    soon = schedule_verdict((roll(100.0),), record, TorqueConfig(), swing)
    late = schedule_verdict((roll(7200.0),), record, TorqueConfig(), swing)
    assert soon.peak_deg > 1.5 * alone.peak_deg
    assert late.peak_deg == pytest.approx(alone.peak_deg, rel=1e-4)


def test_two_halves_of_a_schedule_leave_what_the_whole_leaves(record):
    first, second = (roll(0.0), roll(20.0, -0.02)), (roll(50.0), roll(61.0, 0.01, 3.0))
    whole = swing_after(None, (*first, *second), record)
    parts = swing_after(swing_after(None, first, record), second, record)
    assert whole.at_us == parts.at_us
    np.testing.assert_allclose(parts.phasor_rad, whole.phasor_rad, rtol=1e-9)
    assert swing_after(parts, (), record) is parts


def test_a_rejected_schedule_comes_with_what_helps(record):
    strict = replace(TorqueConfig(), panel_peak_limit_deg=1.5e-4)
    period_s = 2.0 * np.pi / 0.6
    resonant = tuple(roll(k * period_s) for k in range(8))
    reported = schedule_verdict(resonant, record, strict)
    assert reported.verdict == "reject"
    assert reported.suggestion is not None


def test_swings_of_other_modes_are_forgotten_and_a_mode_without_damping_is_given_a_little(record):
    swing = PanelSwing(EPOCH, (1.0 + 0j,))
    reported = schedule_verdict((roll(0.0),), record, TorqueConfig(), swing)
    assert reported == schedule_verdict((roll(0.0),), record, TorqueConfig())
    undamped = replace(record, modes=(replace(MODES[1], damping_ratio=0.0),))
    assert schedule_verdict((roll(0.0),), undamped, TorqueConfig()) is not None
