"""A command that takes the place of another on board takes it on the service, in the journal and in the filter."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import INERTIA, Flight, FlightPayload
from release_service_driver import US, ReleaseServiceDriver
from release_storage import SC
from sign_world import payload

from service.errors import ConflictError
from service.pipeline.estimation.method import CommandEvidence
from service.records.catalogue import Method
from service.records.levels.attitude import Axes
from service.records.levels.command import ReleasedCommand, ReportedCommand
from service.records.operations.release import InterlockHold

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
