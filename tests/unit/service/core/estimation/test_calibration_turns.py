"""Recommended turns: levels, corners, length."""

import numpy as np
import pytest

from service.core.estimation.calibration_turns import FAR_YAW_DEG, recommended_turns


def test_turns_cover_both_signs_of_every_axis_and_all_corners():
    """8.5 hours; far yaw doubles the yaw levels only."""
    turns, far = recommended_turns(), recommended_turns(far_yaw=True)
    angles = np.array([turn.attitude_deg for turn in turns])
    assert sum(turn.minutes for turn in turns) == 510.0
    for axis in range(3):
        assert {-0.5, 0.5} <= set(angles[:, axis])
    corners = {tuple(row) for row in angles if np.count_nonzero(row) == 3}
    assert len(corners) == 8
    changes = np.diff([row for row in angles if np.count_nonzero(row) == 3], axis=0)
    assert (np.count_nonzero(changes, axis=1) == 1).all()
    assert max(turn.attitude_deg[0] for turn in far) == FAR_YAW_DEG
    assert np.array([turn.attitude_deg for turn in far])[:, 1:] == pytest.approx(angles[:, 1:], abs=0.0)
