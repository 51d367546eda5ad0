"""Rows that an alignment runs again are stored in parts: whatever ends one of them, the rows are the same."""

from unittest.mock import patch

import pytest

import service.runtime.live.supervisor as supervisor_module
from service.errors import StorageError
from service.pipeline.checkpoints.chain_state import fingerprint


@pytest.fixture
def waiting(new_ground):
    """Two stations with rows that wait for an alignment."""
    stations = new_ground(), new_ground()
    for station in stations:
        station.append(range(1, 61))
        station.align()
    with stations[0].supervised() as supervisor:
        stations[0].settle(supervisor)
    return stations


def results_of(station):
    return [sequence for sequence, _ in station.storage.results.results_after(station.id, 0, 10_000)]


class Ending:
    """Results whose n-th call to save some outcomes ends something first."""

    def __init__(self, inner, calls, end):
        self._inner, self._left, self._end = inner, calls, end

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def save_outcomes(self, *arguments):
        self._left -= bool(arguments[2])
        if self._left == 0:
            self._left = -1
            self._end()
        return self._inner.save_outcomes(*arguments)


class Parts:
    def __init__(self, storage, results):
        self.catalogue, self.archive, self.results = storage.catalogue, storage.archive, results


def full():
    raise StorageError("storage.unavailable", "the disk is full; make room")


@pytest.mark.parametrize("calls", [2, 4, 7])
def test_a_full_disk_between_two_parts_loses_and_doubles_no_row(waiting, calls):
    whole, broken = waiting
    storage = Parts(broken.storage, Ending(broken.storage.results, calls, full))
    with (
        patch.object(supervisor_module, "_RETRY_S", 0.02),
        patch.object(supervisor_module, "_ENTRIES_AT_ONCE", 10),
        broken.supervised(storage) as supervisor,
    ):
        broken.settle(supervisor)
    assert repr(broken.rows()) == repr(whole.rows())
    assert results_of(broken) == results_of(whole) == list(range(1, 1 + len(results_of(whole))))


def test_a_stop_between_two_parts_keeps_no_state_within_the_alignment(waiting, wait):
    whole, broken = waiting
    made = []
    storage = Parts(broken.storage, Ending(broken.storage.results, 3, lambda: stop(made[0])))

    def stop(supervisor):
        supervisor._is_stopping = True

    with patch.object(supervisor_module, "_ENTRIES_AT_ONCE", 10):
        with broken.supervised(storage) as supervisor:
            made.append(supervisor)
            supervisor.notify(broken.id)
            wait(lambda: not supervisor.is_running)
        head = broken.storage.archive.head(broken.id)
        assert 0 < len(results_of(broken)) < len(results_of(whole))
        kept = broken.storage.results.checkpoints(broken.id, fingerprint(broken.config), 1 << 40)
        assert all(each.number <= head.consumed_number for each in kept)
        with broken.supervised() as supervisor:
            broken.settle(supervisor)
    assert repr(broken.rows()) == repr(whole.rows())
    assert results_of(broken) == list(range(1, 1 + len(results_of(whole))))
