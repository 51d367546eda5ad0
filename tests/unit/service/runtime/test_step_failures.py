"""An estimator that fails again and again says so, tries more and more seldom, and keeps nobody else from working."""

from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from unittest.mock import patch

import pytest
from alarm_rig import START
from synthetic_payload import SC

from service.errors import StorageError
from service.pipeline.chain import Chain
from service.pipeline.estimation.paper.runner import PaperRunner
from service.records.operations.alarms import Severity
from service.runtime.live import supervisor as step_failures
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import StepFailures, Supervisor

OTHER = "other-craft"


@contextmanager
def breaking(spacecraft_id, fault):
    """Let every step of a spacecraft end by an error."""
    plain = Chain.rows

    def broken(chain, measurements, **options):
        if chain.knowledge.spacecraft.id == spacecraft_id:
            raise fault
        return plain(chain, measurements, **options)

    with patch.object(Chain, "rows", broken):
        yield


def test_a_step_is_tried_again_more_and_more_seldom(monkeypatch):
    seconds = [0.0]
    monkeypatch.setattr(step_failures.time, "monotonic", lambda: seconds[0])
    failures, tried = StepFailures(lambda: START), []
    while len(tried) < 12:
        if not failures.is_waiting(SC):
            tried.append(seconds[0])
            failures.note(SC, "step", f"error {len(tried)}")
        seconds[0] += 1.0
    waits_s = [later - earlier for earlier, later in pairwise(tried)]
    assert waits_s == [1.0, 1.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0, 60.0]
    (failure,) = failures.lasting()
    assert (failure.error, failure.since_us, failure.times) == ("error 1", START, 12)
    failures.forget(SC, "step")
    assert not failures.is_waiting(SC)
    assert failures.lasting() == ()


def test_two_failures_are_an_accident_and_an_outage_of_the_database_is_told_by_others():
    failures = StepFailures()
    for _ in range(2):
        failures.note(SC, "step", "KeyError: 'gain'")
    for _ in range(20):
        failures.note(OTHER, "step", "storage.unavailable: the disk is full", is_outage=True)
    assert failures.lasting() == ()
    failures.note(SC, "step", "KeyError: 'gain'")
    assert [each.spacecraft_id for each in failures.lasting()] == [SC]
    assert failures.lasting(OTHER) == ()


@pytest.mark.parametrize("fault", [EOFError("ran out of input"), StorageError("storage.corrupt", "a byte is wrong")])
def test_steps_that_fail_are_told_until_one_succeeds_and_others_go_on(new_ground, wait, caplog, fault):
    ground = new_ground()
    ground.align()
    ground.storage.catalogue.add_spacecraft(replace(ground.storage.catalogue.spacecraft(SC), id=OTHER))
    ground.storage.catalogue.put_plan(OTHER, ground.payload.carriers(), "sha")
    with patch.object(step_failures, "_RETRY_S", 0.02), ground.supervised() as supervisor:
        ground.settle(supervisor)
        with breaking(SC, fault):
            ground.append(range(1, 4))
            supervisor.notify(SC)
            wait(lambda: supervisor.failures.lasting(SC))
            supervisor.notify(OTHER)
            wait(lambda: _is_settled(ground, OTHER))
            (failure,) = supervisor.failures.lasting()
        assert failure.error == f"{type(fault).__name__}: {fault}"
        wait(ground.is_settled)
        wait(lambda: not supervisor.failures.lasting())
    assert len(ground.rows()) == 3
    assert "its state is rebuilt" in caplog.text


def _is_settled(ground, spacecraft_id):
    head = ground.storage.archive.head(spacecraft_id)
    return head.newest_number == head.consumed_number > 0


def test_rows_that_fail_are_told_until_one_is_computed(new_ground, wait):
    ground = new_ground()
    ground.align()
    plain = PaperRunner.steps

    def breaking_rows(runner, measurements, *known, **options):
        if any(ground.at(10) <= each.epoch_us < ground.at(13) for each in measurements):
            raise FloatingPointError("overflow")
        return plain(runner, measurements, *known, **options)

    with patch.object(PaperRunner, "steps", breaking_rows), ground.supervised() as supervisor:
        ground.append(range(1, 12))
        ground.settle(supervisor)
        assert supervisor.failures.lasting() == (), "two may be an accident"
        ground.append([12])
        ground.settle(supervisor)
        wait(lambda: supervisor.failures.lasting())
        (failure,) = supervisor.failures.lasting()
        assert (failure.kind, failure.error) == ("row", "rows of method paper fail, the service log says where")
        ground.append([13])
        ground.settle(supervisor)
        wait(lambda: not supervisor.failures.lasting())


def test_failures_end_where_another_process_leads(new_ground, wait):
    ground = new_ground()
    turns = [1]
    supervisor = Supervisor(ground.storage, LiveFeed(), ground.config, turn=lambda _: turns[0])
    for kind in ("step", "row"):
        for _ in range(step_failures.LASTING):
            supervisor.failures.note(SC, kind, "KeyError: 'gain'")
    turns[0] = 0
    with patch.object(step_failures.time, "monotonic", lambda clock=step_failures.time.monotonic: clock() + 60.0):
        supervisor.start()
        supervisor.notify(SC)
        wait(lambda: not supervisor.failures.lasting())
    supervisor.stop()


@pytest.mark.parametrize("fault", [StorageError("storage.corrupt", "a document"), TypeError("a key")])
def test_the_alarm_needs_nothing_that_is_stored(rig, monkeypatch, fault):
    def unreadable(*_):
        raise fault

    rig.row(1, -40.0, -40.0)
    monkeypatch.setattr(rig.storage.results, "calibrations", unreadable)
    for _ in range(step_failures.LASTING):
        rig.failures.note("craft", "step", "KeyError: 'gain'")
    rig.poll(is_thorough=True)
    alarm = rig.open_alarms()["estimator_failed", "step"]
    assert alarm.severity is Severity.CRITICAL
    assert "every step has failed" in alarm.detail
    assert "KeyError: 'gain'" in alarm.detail
    rig.failures.forget("craft", "step")
    rig.poll()
    assert rig.open_alarms()["estimator_failed", "step"].state == "returned"


def test_three_records_of_a_momentum_refused_one_after_another_alarm(rig):
    rig.row(1, -40.0, -40.0)
    for refused in ([True, True], [False], [True], [True]):
        rig.storage.alarms.count_refused("craft", refused)
        rig.clock.system += 600_000_000
        rig.poll()
        assert ("telemetry_refused", "momentum") not in rig.open_alarms()
    rig.storage.alarms.count_refused("craft", [True])
    rig.poll()
    rig.clock.system += 600_000_000
    rig.poll()
    alarm = rig.open_alarms()["telemetry_refused", "momentum"]
    assert (alarm.severity, alarm.value) == (Severity.WARNING, 3.0)
    rig.storage.alarms.count_refused("craft", [False])
    for _ in range(2):
        rig.clock.system += 600_000_000
        rig.poll()
    assert rig.open_alarms()["telemetry_refused", "momentum"].state == "returned"


def test_a_spacecraft_without_a_row_is_alarmed_on_too(rig, monkeypatch):
    monkeypatch.setattr(rig.clock, "now_us", lambda _: None)
    for _ in range(step_failures.LASTING):
        rig.failures.note("craft", "step", "KeyError: 'gain'")
    rig.poll()
    assert list(rig.open_alarms()) == [("estimator_failed", "step")]
