"""Every storage counts what a replay wrote, deletes whole versions, and keeps a deleted one from everybody."""

from dataclasses import replace
from uuid import uuid4

import pytest

from service.errors import ConflictError, NotFoundError
from service.ports import Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.operations.job import Job, JobState, Replay

EVER = Window(0, 1 << 60)


@pytest.fixture
def add(setting):
    """Return what stores a replay with a job of a state."""

    def made(state=JobState.DONE, **changes):
        name = f"job-{uuid4()}"
        setting.storage.results.add_job(Job(name, "replay", state, 0.5, 5))
        wanted = Replay(0, 10, 20, Method.PAPER, None, 3, "journal", name, 9)
        return setting.storage.results.add_replay(setting.id, replace(wanted, **changes)).version

    return made


@pytest.fixture
def written(setting, make):
    """Outcomes of three measurements."""
    setting.append([10, 20, 30])
    return [Outcome((make.attitude_row(row),), make.torque_command(row)) for row in setting.rows()]


def code_of(call):
    with pytest.raises((NotFoundError, ConflictError)) as caught:
        call()
    return caught.value.code


def test_a_replay_counts_what_it_wrote_each_row_once(setting, add, written):
    version = add()
    setting.consume(written[:2], version)
    setting.consume(written, version)
    found = setting.storage.results.replay(setting.id, version)
    assert (found.attitude_rows, found.torque_rows, found.size_bytes) == (3, 3, 3 * (320 + 640))
    assert (found.state, found.progress, found.error) == (JobState.DONE, 0.5, None)


def test_replays_are_listed_by_span_page_by_page(setting, add):
    results = setting.storage.results
    versions = [add(start_us=10 * k, stop_us=10 * k + 10) for k in range(4)]
    listed = results.replays(setting.id, Window(10, 31), 9, 0)
    assert [each.replay.version for each in listed] == versions[1:]
    assert [each.replay.id for each in results.replays(setting.id, EVER, 2, 1)] == [2, 3]


def test_a_deleted_version_is_nobodys_to_read_or_write_and_its_rows_go(setting, make, add, written):
    results = setting.storage.results
    kept, gone = add(), add()
    for version in (kept, gone):
        setting.consume(written, version)
    results.delete_replay(setting.id, gone)
    calls = (
        lambda: results.replay(setting.id, gone),
        lambda: results.delete_replay(setting.id, gone),
        lambda: results.attitude_rows(setting.id, gone, Method.ROBUST, make.ever, 9, None),
        lambda: results.commands(setting.id, gone, make.ever, 9, None),
    )
    assert {code_of(call) for call in calls} == {"replay.unknown"}
    assert code_of(lambda: setting.consume(written, gone)) == "replay.deleted"
    assert [each.replay.version for each in results.replays(setting.id, EVER, 9, 0)] == [kept]
    assert sum(results.drop_replays(setting.id, None)) == 6
    assert list(results.drop_replays(setting.id, None)) == []
    assert len(results.attitude_rows(setting.id, kept, Method.ROBUST, make.ever, 9, None)) == 3
    assert len(results.commands(setting.id, kept, make.ever, 9, None)) == 3
    # the number is not given again
    assert add() == "replay-3"


def test_retention_takes_finished_versions_by_their_age(setting, add, written):
    results = setting.storage.results
    old, running, new = add(created_at_us=5), add(JobState.RUNNING, created_at_us=5), add(created_at_us=50)
    for version in (old, new):
        setting.consume(written, version)
    assert sum(results.drop_replays(setting.id, 50)) == 6
    assert [each.replay.version for each in results.replays(setting.id, EVER, 9, 0)] == [running, new]
