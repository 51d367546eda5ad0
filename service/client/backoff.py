"""Waiting times between attempts: doubling, bounded, never in step with other stations.

Law of this file: it computes times and waits for none.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(slots=True)
class Backoff:
    """Waiting times 1, 2, 4 .. 60 s with jitter.

    Parameters
    ----------
    first_s : float
        First waiting time.
    limit_s : float
        Longest waiting time.
    jitter : float
        Largest part by which a waiting time is shortened, 0..1.
    draw : callable
        Uniform random numbers in [0, 1).

    Examples
    --------
    >>> backoff = Backoff(jitter=0.0)
    >>> [backoff.next_s() for _ in range(8)]
    [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    """

    first_s: float = 1.0
    limit_s: float = 60.0
    jitter: float = 0.2
    draw: Callable[[], float] = field(default_factory=lambda: random.Random().random)  # noqa: S311 - spreads load only
    _next_s: float = field(default=0.0, init=False)

    def next_s(self) -> float:
        """Return the next waiting time, s."""
        base_s = self._next_s or self.first_s
        self._next_s = min(2.0 * base_s, self.limit_s)
        return min(base_s, self.limit_s) * (1.0 - self.jitter * self.draw())

    def reset(self) -> None:
        """Start again from the first waiting time."""
        self._next_s = 0.0
