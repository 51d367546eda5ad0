"""Does the clock that stamps the rows run evenly? A jump is flagged, counted and told, in either direction.

The computer's clock is compared with its monotonic one from row to row; the analyzer's calendar can only be seen to run
backwards. Epochs are handed on as the clock has them: a clock that was set right is right from then on, and an epoch
that lies before its predecessor carries the flag that says so.
"""

import logging

from service.records.epoch import US_PER_S
from service.records.levels.measurement import QualityFlag

logger = logging.getLogger("service.frontend.acquisition.epoch_guard")

#: difference between two clocks from row to row that counts as a jump: slewing and drift stay far below, s
JUMP_S = 0.5
#: slewing changes a clock by half a thousandth at most
SLEW_RATE = 1e-3
#: rows are flagged for so long after a jump, s
SETTLE_S = 60.0


class EpochGuard:
    """Watches the clock of one acquisition.

    Parameters
    ----------
    has_monotonic : bool
        The epochs come from this computer, so that its monotonic clock can judge them.
    """

    def __init__(self, *, has_monotonic: bool) -> None:
        self.jumps = 0
        #: the newest jump in words, empty while the clock is trusted
        self.warning = ""
        self._has_monotonic = has_monotonic
        self._last: tuple[int, float] | None = None
        self._untrusted_until_s = float("-inf")

    def judge(self, epoch_us: int, monotonic_s: float) -> QualityFlag:
        """Return the flag of a row with this epoch, seen at this monotonic time."""
        jump_s = self._jump_s(epoch_us, monotonic_s)
        if jump_s is not None:
            self.jumps += 1
            self._untrusted_until_s = monotonic_s + SETTLE_S
            self.warning = f"the clock went {'back' if jump_s < 0.0 else 'forward'} by {abs(jump_s):.3f} s"
            logger.warning("%s; rows are flagged CLOCK_UNSYNC for %g s", self.warning, SETTLE_S)
        self._last = (epoch_us, monotonic_s)
        if monotonic_s < self._untrusted_until_s:
            return QualityFlag.CLOCK_UNSYNC
        self.warning = ""
        return QualityFlag(0)

    def _jump_s(self, epoch_us: int, monotonic_s: float) -> float | None:
        """Return by how much the clock jumped since the last row; None when it did not."""
        if self._last is None:
            return None
        passed_s = (epoch_us - self._last[0]) / US_PER_S
        if not self._has_monotonic:
            return passed_s if passed_s <= 0.0 else None
        due_s = monotonic_s - self._last[1]
        jump_s = passed_s - due_s
        return jump_s if abs(jump_s) > JUMP_S + SLEW_RATE * due_s else None
