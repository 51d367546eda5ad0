"""A service that is killed before or after the results of any row, again and again: the rows are those of one life."""

import random

import numpy as np
import pytest
from busy_station import BOTH, SC, morning, text, wait_for

from service.errors import StorageError
from service.pipeline.config import ChainConfig
from service.runtime.live import supervisor as live
from service.runtime.live.live_feed import LiveFeed

MINUTE_US = 60_000_000


class MortalResults:
    """Results of a process that is killed at one of its commits: from then on it stores nothing."""

    def __init__(self, inner, saves_left, is_stored):
        self._inner, self._left, self._is_stored = inner, saves_left, is_stored
        self.is_dead = False

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def save_outcomes(self, *arguments):
        self._left -= 1
        stored = None
        if self._left > 0 or (self._left == 0 and self._is_stored):
            stored = self._inner.save_outcomes(*arguments)
        if self._left <= 0:
            self.is_dead = True
            message = "this process is killed"
            raise StorageError("storage.unavailable", message)
        return stored


class Parts:
    def __init__(self, storage, results):
        self.catalogue, self.archive, self.results = storage.catalogue, storage.archive, results


def live_and_die(station, rng):
    """Run a service until it is killed or there is nothing left; return whether it was killed."""
    results = MortalResults(station.storage.results, rng.randint(1, 25), rng.random() < 0.5)
    service = live.Supervisor(Parts(station.storage, results), LiveFeed(), ChainConfig())
    service.start()
    service.notify(SC)
    wait_for(lambda: results.is_dead or station.is_settled())
    is_killed = results.is_dead
    # no last words either
    results.is_dead, results._left = True, 0
    results._is_stored = False
    service.stop()
    return is_killed


@pytest.mark.parametrize("seed", range(30))
def test_the_rows_are_those_of_a_service_that_was_never_killed(
    seed, lived_archive, opened_archive, new_station, monkeypatch
):
    print(f"seed {seed}")
    through, broken, rng = new_station(lived_archive), new_station(opened_archive), random.Random(seed)
    # every row is a commit of its own; checkpoints are close or far
    monkeypatch.setattr(live, "_STEP_S", 0.0)
    monkeypatch.setattr(live, "_ENTRIES_AT_ONCE", 1)
    monkeypatch.setattr(live, "PERIOD_US", rng.choice([1, 7, 60]) * MINUTE_US)
    monkeypatch.setattr(live, "_RETRY_S", 60.0)
    kills = 0
    for _ in morning(broken):
        while live_and_die(broken, rng):
            kills += 1
    assert kills > 5
    for method in BOTH:
        assert text(broken.rows(method)) == text(through.rows(method))
    assert text(broken.commands()) == text(through.commands())
    sequences = [sequence for sequence, _ in broken.storage.results.results_after(SC, 0, 100_000)]
    assert sequences == np.arange(1, 1 + len(sequences)).tolist()
