"""Star tracker: attitude references with white noise while it is on, nothing after."""

from dataclasses import dataclass

import numpy as np

from analyzer_sim.orbit import EpochArray
from analyzer_sim.streams import FloatArray, stream

#: white noise of a reference, deg, order yaw, roll, pitch
SIGMA_DEG = (0.015, 0.008, 0.008)


@dataclass(frozen=True, slots=True)
class References:
    """Attitudes as the star tracker told them."""

    #: (R,) microseconds
    epochs_us: EpochArray
    #: (R, 3) deg, order yaw, roll, pitch
    attitude_deg: FloatArray


def references(seed: int, epochs_us: EpochArray, attitude_deg: FloatArray, off_us: int) -> References:
    """Return one reference a row for the rows before `off_us`."""
    count = int(np.searchsorted(epochs_us, off_us))
    noise = stream(seed, "star tracker").normal(size=(count, 3)) * np.array(SIGMA_DEG)
    return References(epochs_us[:count], np.round(attitude_deg[:count] + noise, 6))
