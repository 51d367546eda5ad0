"""Commands that replace another, sign checks leg by leg, and trips within a batch, on the release service."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import INERTIA, Flight, FlightPayload
from release_service_driver import US, ReleaseServiceDriver
from release_storage import SC
from sign_world import payload

from service.errors import ConflictError
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release.events import OrderKind
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.pipeline.estimation.method import CommandEvidence
from service.ports.storage import ClockReading
from service.records.catalogue import Method
from service.records.levels.attitude import AppliedCommand, Axes, ReleasedCommand, ReportedCommand
from service.records.operations.release import InterlockHold
from service.runtime.control.release_context import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor

PAYLOAD = FlightPayload.make()
#: about yaw, roll, pitch
MOMENTS = np.array([INERTIA[2][2], INERTIA[0][0], INERTIA[1][1]])


def replaced() -> tuple[ReleaseServiceDriver, object, object]:
    """Report all of a command executed while its end lies ahead, and release one that begins before that end."""
    driver = ReleaseServiceDriver().armed()
    first = driver.sent()
    driver.rows(1)
    assert driver.report(1).executed == first.schedule
    driver.rows(7, attitude_deg=Axes(0.02, -0.05, 0.04))
    second = driver.sent()
    assert first.start_us < second.start_us < first.stop_us
    driver.rows(20)
    return driver, first, second


def before(schedule, stop_us):
    """Return what of some pulses a spacecraft flies that leaves them at an instant."""
    kept = (p for p in schedule if p.start_us < stop_us)
    return tuple(replace(p, duration_s=min(p.duration_s, (stop_us - p.start_us) / US)) for p in kept)


def turned_deg(pulses, at_us):
    """Return what pulses have turned a free body by an instant."""
    turned = np.zeros(3)
    for pulse in pulses:
        acted_s = min(pulse.duration_s, max(0.0, (at_us - pulse.start_us) / US))
        left_s = (at_us - pulse.start_us) / US - 0.5 * acted_s
        turned += np.degrees(np.array(pulse.torque_n_m) * acted_s * left_s / MOMENTS)
    return turned


def test_the_service_tells_what_was_flown_before_the_later_command_began() -> None:
    driver, first, second = replaced()
    assert driver.service.command(SC, 1).executed == first.schedule  # until it is known that the second was flown
    assert driver.report(2).executed == second.schedule
    reported = driver.service.command(SC, 1)
    assert reported.executed == before(first.schedule, second.start_us)
    assert 0 < len(reported.executed) < len(first.schedule)
    assert (reported.state, reported.schedule) == ("EXECUTED", first.schedule)


def test_a_later_command_that_failed_leaves_the_earlier_one_whole() -> None:
    driver, first, _ = replaced()
    driver.report(2, "failed")
    assert driver.service.command(SC, 1).executed == first.schedule


def test_what_was_left_out_is_told_after_a_restart_too() -> None:
    driver, first, second = replaced()
    driver.restart()
    driver.report(2)
    assert driver.service.command(SC, 1).executed == before(first.schedule, second.start_us)


def test_a_sign_check_cuts_no_command_short() -> None:
    """The filter is not told of a sign check, so it would count on what the check has left out."""
    driver = ReleaseServiceDriver().armed()
    first = driver.sent()
    driver.report(1)
    evidence = CommandEvidence(payload(5), np.zeros(payload(5).carriers), 0.0, None)
    driver.rows(1, evidence=evidence)
    with pytest.raises(ConflictError, match=r"sign_check\.flying: command 1 is still flown"):
        driver.service.sign_check(SC, "roll", "ann")
    while driver.clock.now < first.stop_us:
        driver.rows(1, evidence=evidence)
    assert driver.service.sign_check(SC, "roll", "ann").sign_check.state == "running"


@pytest.mark.parametrize("is_flown", [True, False], ids=["flown", "lost"])
def test_the_filter_that_reads_the_journal_of_the_service_follows_the_craft(is_flown) -> None:
    driver, first, second = replaced()
    driver.report(2, "executed" if is_flown else "failed")
    entries = [entry for entry in driver.releases.reported if not isinstance(entry, InterlockHold)]
    assert [type(entry) for entry in entries] == [ReleasedCommand, ReportedCommand] * 2
    flown = (*before(first.schedule, second.start_us), *second.schedule) if is_flown else first.schedule
    flight = Flight(PAYLOAD, methods=(Method.ROBUST,))
    offset_us = flight.at(1) - first.released_us
    end = 60
    for minute in range(1, end + 1):
        while entries and _known_us(entries[0]) + offset_us <= flight.at(minute):
            flight.chain.update(_shifted(entries.pop(0), offset_us))
        # no power tells the filter anything: what it knows of the angles it knows from the journal
        row = flight.robust(flight.changed(minute, np.nan))
    assert not entries
    at_us = flight.at(end) - offset_us
    turned, of_all = turned_deg(flown, at_us), turned_deg((*first.schedule, *second.schedule), at_us)
    assert np.abs(turned - of_all).max() > 0.01
    np.testing.assert_allclose(np.array(row.attitude_deg) - flight.truth_deg, turned, atol=1e-6)


def _known_us(entry) -> int:
    return entry.released_us if isinstance(entry, ReleasedCommand) else entry.reported_us


def _shifted(entry, offset_us):
    """Return an entry at another time."""
    name = "schedule" if isinstance(entry, ReleasedCommand) else "executed"
    pulses = tuple(replace(pulse, start_us=pulse.start_us + offset_us) for pulse in getattr(entry, name))
    return replace(entry, **{name: pulses})


class DataClock:
    """The clock of the data, by the archive's head."""

    def __init__(self, ground):
        self._ground = ground

    def now_us(self, spacecraft_id):
        return self._ground.storage.archive.head(spacecraft_id).newest_epoch_us

    def is_data(self, spacecraft_id):
        return True

    def reading(self, spacecraft, newest_epoch_us):
        return ClockReading(is_data=True, now_us=newest_epoch_us)

    def system_us(self):
        return 1_900_000_000_000_000


class Watched:
    """A release service of which an operator stops control at a row, after it was computed and before it is stored."""

    def __init__(self, service, stop_after):
        self.service, self.stop_after, self.parts = service, stop_after, 0

    def on_rows(self, spacecraft_id, seen, *, has_inputs=False):
        self.service.on_rows(spacecraft_id, seen, has_inputs=has_inputs)
        self.parts += any(one.outcome.applied is not None for one in seen)

    @contextmanager
    def steady(self, spacecraft_id):
        if self.parts == self.stop_after:
            self.parts += 1
            self.service.order(spacecraft_id, OrderKind.STOP, "ann")
        with self.service.steady(spacecraft_id) as is_withheld:
            yield is_withheld


@contextmanager
def released(ground, stop_after, settings):
    publisher = ReleasePublisher(ground.storage.audit, LiveFeed(), lambda _: None)
    service = ReleaseService(ground.storage, DataClock(ground), settings, TorqueConfig(), publisher)
    supervisor = Supervisor(ground.storage, LiveFeed(), ground.config, release=Watched(service, stop_after))
    supervisor.start()
    try:
        yield supervisor, service
    finally:
        supervisor.stop()


@pytest.mark.parametrize(
    ("stop_after", "settings"),
    [
        pytest.param(3, ReleaseSettings(), id="an operator stops between computing and storing"),
        pytest.param(-1, ReleaseSettings(impulse_n_m_s=1e-4), id="a command of the batch itself trips"),
    ],
)
def test_rows_behind_a_trip_get_no_torque_live_and_in_a_replay(ground, stop_after, settings):
    ground.append(range(1, 301))
    with released(ground, stop_after, settings) as (supervisor, service):
        ground.settle(supervisor)
        assert service.control(ground.id).state == "TRIPPED"
        ground.append(range(301, 306))
        ground.settle(supervisor)
    entries = [entry.content for entry in ground.storage.archive.journal(ground.id, 0, 10_000)]
    (hold,) = [each for each in entries if isinstance(each, InterlockHold)]
    applied = [each.command for each in entries if isinstance(each, AppliedCommand)]
    assert len(applied) == stop_after or [bool(each.schedule) for each in applied].count(True) == 1
    assert max(each.attitude_epoch_us for each in applied) <= hold.at_us
    commands = ground.commands()
    later = [each for each in commands if each.attitude_epoch_us > hold.at_us]
    assert len(later) > 20
    for command in later:
        assert (command.control_allowed, command.schedule, "tripped" in command.inhibitions) == (False, (), True)
        assert command.torque_n_m == (0.0, 0.0, 0.0)
    version = ground.replay(1, 320)
    replayed = ground.commands(version)
    assert [repr(each) for each in replayed] == [repr(each) for each in commands]
    assert [repr(each) for each in ground.rows(version)] == [repr(each) for each in ground.rows()]


def test_a_service_killed_between_trip_and_rows_withholds_them_after_its_start(ground):
    publisher = ReleasePublisher(ground.storage.audit, LiveFeed(), lambda _: None)
    service = ReleaseService(ground.storage, DataClock(ground), ReleaseSettings(), TorqueConfig(), publisher)
    ground.append(range(1, 41))
    # stopped before any of them is computed: all are later than what anybody has seen
    service.order(ground.id, OrderKind.STOP, "ann")
    with released(ground, -1, ReleaseSettings()) as (supervisor, _):
        ground.settle(supervisor)
    assert not any(each.control_allowed for each in ground.commands())
    assert any("tripped" in each.inhibitions for each in ground.commands())
