"""Fixed dish of a user: the satellite moves through its beam.

    loss = 12 |o + m(t)|^2 / w^2 - 12 |o|^2 / w^2   dB

`o` is the mispointing of the dish, `m` the motion of the line of sight, `w` the half-power width, all in deg. The
loss is counted from what the dish loses when the satellite stands at its nominal place. This, not the body's motion,
makes the daily harmonic of a carrier: first harmonic up to 24 |o| |m| / w^2, second up to 6 |m|^2 / w^2.
"""

import numpy as np

from analyzer_sim.streams import FloatArray, stream

#: mispointing relative to the half-power width
MISPOINTING_SHARE = (0.06, 0.12)


def mispointing_deg(seed: int, carrier: str, dish_width_deg: float) -> FloatArray:
    """Return the drawn mispointing (2,) of a user's dish, along and across."""
    rng = stream(seed, "dish", carrier)
    size_deg, angle = dish_width_deg * rng.uniform(*MISPOINTING_SHARE), rng.uniform(0.0, 2.0 * np.pi)
    return np.asarray(size_deg * np.array([np.cos(angle), np.sin(angle)]))


def dish_loss_db(motion_deg: FloatArray, offset_deg: FloatArray, width_deg: float) -> FloatArray:
    """Return the loss (T,) of a dish for motions (T, 2), relative to the nominal place.

    Examples
    --------
    >>> float(dish_loss_db(np.array([[0.05, 0.0]]), np.array([0.1, 0.0]), 1.0)[0].round(6))
    0.15
    """
    position = np.sum((motion_deg + offset_deg) ** 2, axis=1) - np.sum(offset_deg**2)
    return np.asarray(12.0 * position / width_deg**2)
