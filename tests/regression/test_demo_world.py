"""The demonstration's figures on the simulator's truth, array in, rows out: both methods end to end.

Every rms stands beside the rms of the truth and beside the answer that the spacecraft never moves, which must miss the
bounds. Levels enter as the archive keeps them, float32.
"""

import exported_world
import numpy as np
import pytest

from analyzer_sim.export import export_npz
from analyzer_sim.world.scenario.scenario import SCENARIOS
from analyzer_sim.world.world import World
from service.study.demonstration.merit import AXES, judge_axis, missed_bounds
from service.study.estimation.flight.drive import drive
from service.study.estimation.flight.world import read_world

SEEDS = (1, 2, 3)
#: rows of the first hour: the trailing mean and the first slope must have filled
SETTLING_ROWS = 60


def judge(estimate_deg, truth_deg):
    """Return the figures of each axis after settling."""
    return {
        axis: judge_axis(estimate_deg[SETTLING_ROWS:, k], truth_deg[SETTLING_ROWS:, k]) for k, axis in enumerate(AXES)
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_demonstration_meets_its_bounds_and_the_answer_that_never_moves_does_not(seed):
    """Two days of operation, calibrated and aligned by the service itself; one drive serves every claim."""
    day = exported_world.driven(SCENARIOS["demo"], seed)
    merits = judge(day.estimate_deg, day.truth_deg)
    for axis, merit in merits.items():
        figures = " ".join(f"{name} {value:.3f}" for name, value in merit._asdict().items())
        print(f"seed {seed} {axis}: {figures}")
    # the demonstration's own bounds: rms .08 and .10 deg, slope 1 +- .15, truth rms .12 deg on each axis
    assert missed_bounds(merits, "paper") == []
    _zero_misses(day)
    _sigma_is_honest(day, seed)
    _commands_agree_with_rows(day, seed)


def _zero_misses(day):
    """The answer 0/0/0 has neither slope nor rms."""
    missed = missed_bounds(judge(np.zeros_like(day.truth_deg), day.truth_deg), "paper")
    assert [text.split(" ")[:2] for text in missed] == [
        ["roll", "rms"],
        ["roll", "slope"],
        ["pitch", "rms"],
        ["pitch", "slope"],
    ]


def _sigma_is_honest(day, seed):
    """Errors of roll and pitch are of the size of the row's own sigma."""
    sigma = np.array([row.sigma_deg for row in day.rows])[SETTLING_ROWS:, 1:]
    error = (day.estimate_deg - day.truth_deg)[SETTLING_ROWS:, 1:]
    ratio = np.sqrt(np.nanmean((error / sigma) ** 2, axis=0))
    print(f"seed {seed}: rms of error over own sigma, roll {ratio[0]:.2f} pitch {ratio[1]:.2f}")
    # what the levels wandered since the alignment and the lag of a quarter-hour mean are not in a snapshot's
    # covariance: up to three times its sigma
    assert (ratio < 3.0).all()
    assert (ratio > 0.3).all()


def _commands_agree_with_rows(day, seed):
    """A command is zero exactly where it says why, and repeats every reason of its row."""
    allowed = np.array([row.control_allowed for row in day.rows])[SETTLING_ROWS:]
    print(f"seed {seed}: control allowed in {allowed.mean():.3f} of the rows")
    # nothing in this story forbids control but rain on three users, which the fix leaves out
    assert allowed.mean() >= 0.9
    for row, command in zip(day.rows, day.commands, strict=True):
        assert command.control_allowed == (not command.inhibitions)
        assert command.control_allowed or not any(command.torque_n_m)
        assert row.control_allowed or set(row.inhibitions) <= set(command.inhibitions)


@pytest.mark.slow
def test_the_robust_method_meets_its_bounds_in_the_demonstrations_world(tmp_path):
    """Seed 4; seed 1 is the demonstration's own."""
    path = tmp_path / "demo.npz"
    export_npz(World(SCENARIOS["demo"], 4), path)
    world = read_world(path)
    driven = drive(world.ground)
    truth = world.truth.attitude_deg[driven.rows]
    merits = judge(driven.methods["robust"].estimate_deg, truth)
    print({axis: tuple(round(float(value), 3) for value in merit) for axis, merit in merits.items()})
    assert missed_bounds(merits, "robust") == []
    zeros = judge(np.zeros_like(truth), truth)
    assert {text.split(" ")[0] for text in missed_bounds(zeros, "robust")} == {"yaw", "roll", "pitch"}
