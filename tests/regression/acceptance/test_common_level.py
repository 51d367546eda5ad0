"""Acceptance test 8: the level of all carriers steps in mid-operation; the product calibrated, aligned and flown.

The shift is the largest distance from the flight of the same noise without the step.
"""

import numpy as np
import pytest
from driven_world import shared_world

SEEDS, NIGHTLY_SEEDS = {"nominal": 5, "dual_band": 11}, (4, 6, 11, 12, 13, 14)
#: the seed on which a fall of ten hours is worst
LONG_SEED = 5
STEPS_DB, WORLDS = (3.0, 0.5, -0.4, -3.0), tuple(SEEDS)
STEP_H = 2.0
SHIFT_DEG = np.array([0.08, 0.02, 0.03])
#: rows for which control is held when all levels rise at once
HELD_ROWS = 10


def stepped(world, step_db, until_h=6.0):
    """Return the flight with a step of all carriers, and say what it did."""
    reported = world.fly(world.changed(STEP_H, np.inf, step_db), until_h=until_h)
    shift = reported.shift_deg(world.plain, STEP_H, until_h)
    off = int((~reported.is_allowed[reported.between(STEP_H)]).sum())
    print(f"step {step_db:+} dB for {until_h - STEP_H} h: shift {shift.round(4)}, control off for {off} rows")
    return reported, shift, off


def assert_control(reported, step_db, off):
    """Up: control is held for ten rows; a little down: it is back in 2.5 h; far down: it stays off."""
    assert reported.is_allowed[reported.between(1.0, STEP_H)].all(), "control before the step"
    if step_db > 0.0:
        assert off == HELD_ROWS
        assert reported.says("chain_step")[reported.between(STEP_H)][:HELD_ROWS].all()
    elif step_db > -1.0:
        # a small fall that stands still is a step of the chain after an hour and a half
        assert not reported.is_allowed[reported.between(STEP_H)][5]
        assert reported.is_allowed[reported.between(STEP_H + 2.5)].all()
    else:
        assert off == reported.between(STEP_H).sum()
        assert reported.is_fade[reported.between(STEP_H)].all()


@pytest.mark.slow
@pytest.mark.parametrize("step_db", STEPS_DB)
@pytest.mark.parametrize("name", WORLDS)
def test_a_step_of_all_carriers_turns_little(name, step_db):
    """Four hours after it, in one band and in two (there the rain of the scenario comes later than the flight ends)."""
    reported, shift, off = stepped(shared_world(name, SEEDS[name]), step_db)
    assert_control(reported, step_db, off)
    assert (shift <= SHIFT_DEG).all()


@pytest.mark.nightly
@pytest.mark.parametrize("step_db", STEPS_DB)
@pytest.mark.parametrize("name", WORLDS)
def test_a_step_of_all_carriers_turns_little_over_seeds(name, step_db):
    """Mean of six seeds, as all figures of the method are stated."""
    shifts = []
    for seed in NIGHTLY_SEEDS:
        reported, shift, off = stepped(shared_world(name, seed), step_db)
        assert_control(reported, step_db, off)
        shifts.append(shift)
    print(f"{name}, seeds {NIGHTLY_SEEDS}: mean shift {np.mean(shifts, axis=0).round(4)}")
    assert (np.mean(shifts, axis=0) <= SHIFT_DEG).all()


@pytest.mark.nightly
@pytest.mark.xfail(
    strict=True,
    reason="measured .069/.016/.032 deg on seed 14 (pitch .022 to .032 on seven seeds, mean .028): rain that C band "
    "does not feel is the first guess, until C band has shown for some rows that it fell as well",
)
def test_the_worst_small_fall_of_two_bands():
    _, shift, _ = stepped(shared_world("dual_band", 14), -0.4)
    assert (shift <= SHIFT_DEG).all()


@pytest.mark.slow
def test_a_fall_that_stands_for_ten_hours_turns_no_more():
    """Control stays off, and the attitude goes on as if nothing had happened."""
    reported, shift, off = stepped(shared_world("nominal", LONG_SEED), -3.0, until_h=12.0)
    assert off == reported.between(STEP_H).sum()
    assert (shift <= SHIFT_DEG).all()
    assert not reported.says("innovations").any()
    assert not reported.says("unannounced_motion").any()
