"""Claims about commands between release and report: uncertain until then, and afterwards as if always known."""

import re
from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import HOUR, INERTIA, Flight, FlightPayload, applied_command

from service.pipeline.estimation.robust import runner as robust_runner
from service.pipeline.estimation.robust.attitude_rows import known_disturbance
from service.records.catalogue import AxisTorques, FedForwardTorque, Method, Onboard
from service.records.inputs import AlignmentSet, Correction, SpacecraftChange
from service.records.levels.attitude import AppliedCommand, Axes, Pulse, ReleasedCommand, ReportedCommand, Status

PAYLOAD = FlightPayload.make()
ZERO = Axes(0.0, 0.0, 0.0)
#: minutes, s, N m: 0.1 deg about roll and pitch in a quarter of an hour, and the pulse that ends both
SLEW = ((10.2, 20.0, (0.0, 2.5e-4, 0.0)), (10.6, 20.0, (0.0, 0.0, -1.4e-4)), (25.2, 20.0, (0.0, -2.5e-4, 1.4e-4)))
LAST = 34
MARK = r"number=\w+, counter=\w+"


def chain_of(**options):
    """Return a chain of the robust method alone."""
    return Flight(PAYLOAD, methods=(Method.ROBUST,), **options)


def pulses(flight, announced=SLEW):
    return tuple(Pulse(flight.at(start), duration_s, Axes(*torque)) for start, duration_s, torque in announced)


def released(flight, counter=1, announced=SLEW, minute=5):
    return ReleasedCommand(counter, flight.at(minute), pulses(flight, announced))


def reported(flight, counter=1, announced=SLEW, minute=20):
    return ReportedCommand(counter, flight.at(minute), pulses(flight, announced))


def applied(flight, announced=SLEW, minute=5):
    return applied_command(flight.at(minute), pulses(flight, announced), period_s=3600.0)


def turned_deg(minute, announced=SLEW):
    """Return what the pulses have turned by a minute; roll and yaw are not coupled here."""
    turned = np.zeros(3)
    for start, duration_s, torque in announced:
        rate = np.degrees(np.array(torque) * duration_s / [INERTIA[2][2], INERTIA[0][0], INERTIA[1][1]])
        turned += rate * max(0.0, 60.0 * (minute - start) - 0.5 * duration_s)
    return turned


def flown(flight, inputs, last=LAST, announced=SLEW):
    """Fly rows with inputs of minutes; the spacecraft does what ``told`` says."""
    noise, rows = np.random.default_rng(6).normal(0.0, 0.05, (last + 1, 16)), []
    for minute in range(1, last + 1):
        for content in inputs.get(minute, ()):
            flight.chain.update(content)
        rows.append(
            flight.robust(flight.changed(minute, noise[minute], flight.truth_deg + turned_deg(minute, announced)))
        )
    return rows


def state_of(flight):
    return flight.chain._runners[0]._state


def assert_same(first, second):
    """Claim that two filters know the same, to the last bit."""
    one, other = state_of(first), state_of(second)
    np.testing.assert_array_equal(one.filter.mean, other.filter.mean)
    np.testing.assert_array_equal(one.filter.covariance, other.filter.covariance)
    # detectors, sums and motions that are still to come too
    # motions keep the number or the counter of their command
    assert re.sub(MARK, "", repr(one)) == re.sub(MARK, "", repr(other))


@pytest.fixture
def flight():
    return chain_of()


# ---- the report -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [6, 18, 30], ids=["before it acts", "within", "after rows"])
def test_reported_executed_is_known_from_the_release_on(flight, after):
    known = chain_of()
    rows = flown(flight, {5: (released(flight),), after: (reported(flight),)})
    same = flown(known, {5: (applied(known),)})
    assert_same(flight, known)
    assert [repr(row) for row in rows[after - 1 :]] == [repr(row) for row in same[after - 1 :]]
    assert all(row.control_allowed for row in rows[after:])


@pytest.mark.parametrize("after", [6, 18, 30])
def test_reported_failed_was_never_released(flight, after):
    never = chain_of()
    flown(flight, {5: (released(flight),), after: (reported(flight, announced=()),)}, announced=())
    flown(never, {}, announced=())
    assert_same(flight, never)


@pytest.mark.parametrize(
    "executed", [SLEW[:1], SLEW[:2], ((10.2, 7.5, (0.0, 0.0063, 0.0)),)], ids=["one pulse", "two", "cut short"]
)
def test_what_was_executed_in_part_is_known_in_part(flight, executed):
    known = chain_of()
    rows = flown(flight, {5: (released(flight),), 15: (reported(flight, announced=executed),)}, announced=executed)
    flown(known, {5: (applied(known, executed),)}, announced=executed)
    assert_same(flight, known)
    angles = flight.truth_deg + turned_deg(LAST, executed)
    np.testing.assert_allclose(np.array(rows[-1].attitude_deg)[1:], angles[1:], atol=0.02)


def test_between_release_and_report_the_effect_is_uncertain(flight):
    never = chain_of()
    flown(flight, {5: (released(flight),)}, last=9, announced=())
    flown(never, {}, last=9, announced=())
    # nothing has acted yet: the filter knows what it knew
    one, other = (state_of(chain).filter.mean[:9] for chain in (flight, never))
    np.testing.assert_allclose(one, other, rtol=1e-12)
    absent, other = (one.robust(one.changed(30, np.nan)) for one in (flight, never))
    np.testing.assert_allclose(absent.attitude_deg, other.attitude_deg, rtol=1e-12)
    for axis in ("roll", "pitch"):
        turned = dict(zip(("roll", "pitch"), turned_deg(30)[1:], strict=True))[axis]
        grown = np.sqrt(getattr(absent.sigma_deg, axis) ** 2 - getattr(other.sigma_deg, axis) ** 2)
        assert grown == pytest.approx(abs(turned), rel=1e-6)  # one sigma: all of it, or the opposite
    assert absent.sigma_deg.yaw == pytest.approx(other.sigma_deg.yaw, rel=1e-9)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_powers_tell_of_a_command_that_nobody_reports(flight, share):
    announced = tuple((start, duration_s, tuple(share * np.array(torque))) for start, duration_s, torque in SLEW)
    rows = flown(flight, {5: (released(flight),)}, announced=announced)
    position = 11
    gaussian = state_of(flight).filter.gaussian
    assert gaussian.mean[position] == pytest.approx(share, abs=0.1)
    assert np.sqrt(gaussian.covariance[position, position]) < 0.1
    np.testing.assert_allclose(
        np.array(rows[-1].attitude_deg)[1:], (flight.truth_deg + turned_deg(LAST, announced))[1:], atol=0.02
    )
    assert not any("unannounced_motion" in row.inhibitions for row in rows)


def test_reports_of_unknown_and_finished_commands_do_nothing(flight):
    once = chain_of()
    flown(once, {5: (released(once),), 20: (reported(once),)})
    inputs = {5: (reported(flight, 9), released(flight)), 20: (reported(flight), reported(flight)), 28: ()}
    flown(flight, {**inputs, 30: (reported(flight, announced=()), reported(flight, 7))})
    assert_same(flight, once)


def test_a_release_that_is_told_twice_counts_once(flight):
    once = chain_of()
    flown(once, {5: (released(once),), 20: (reported(once),)})
    flown(flight, {5: (released(flight), released(flight)), 20: (reported(flight),)})
    assert_same(flight, once)


def test_the_same_journal_gives_the_same_bits(flight):
    again = chain_of()
    for one in (flight, again):
        flown(one, {5: (released(one),), 30: (reported(one, announced=SLEW[:2]),)}, announced=SLEW[:2])
    assert_same(flight, again)


# ---- more than one, and what comes between --------------------------------------------------------------------------

LATER = ((28.0, 10.0, (0.0, 0.0, 2e-4)),)


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_reports_of_two_commands_may_come_in_any_order(flight, order):
    known = chain_of()
    contents = {1: reported(flight, announced=SLEW[:2]), 2: reported(flight, 2, LATER)}
    both = (*SLEW[:2], *LATER)
    first, second = (contents[counter] for counter in order)
    inputs = {5: (released(flight),), 22: (released(flight, 2, LATER),), 30: (first,), 32: (second,)}
    flown(flight, inputs, announced=both)
    flown(known, {5: (reported_at_once(known, SLEW[:2]),), 22: (reported_at_once(known, LATER),)}, announced=both)
    assert_same(flight, known)


def reported_at_once(flight, announced):
    """Return a command that counts as applied and that the next one does not end."""
    return AppliedCommand(replace(applied(flight, announced).command, number=0))


#: begins before the last pulse of the slew, and in the middle of one that lasts
NEXT = ((20.0, 10.0, (0.0, -2e-4, 0.0)),)
LONG = ((12.0, 600.0, (0.0, 4e-6, 0.0)), (24.0, 20.0, (0.0, -1e-4, 0.0)))
LONG_CUT = ((12.0, 480.0, (0.0, 4e-6, 0.0)),)


@pytest.mark.parametrize(("first", "flown_of_it"), [(SLEW, SLEW[:2]), (LONG, LONG_CUT)], ids=["between", "in flight"])
@pytest.mark.parametrize("reports", [{15: 1, 30: 2}, {18: 1, 19: 2}, {30: 1, 31: 2}, {30: 2, 31: 1}], ids=str)
def test_a_later_command_takes_the_place_of_what_an_earlier_one_has_left(flight, first, flown_of_it, reports):
    """The report says that all of the first was executed, also where its tail still lay ahead."""
    known = chain_of()
    both = (*flown_of_it, *NEXT)
    inputs = {5: (released(flight, announced=first),), 16: (released(flight, 2, NEXT),)}
    for minute, counter in reports.items():
        inputs[minute] = (*inputs.get(minute, ()), reported(flight, counter, first if counter == 1 else NEXT))
    rows = flown(flight, inputs, announced=both)
    announced = {5: (reported_at_once(known, flown_of_it),), 16: (reported_at_once(known, NEXT),)}
    same = flown(known, announced, announced=both)
    assert state_of(flight).released == ()
    for one, other in zip(state_of(flight).filter.gaussian[:2], state_of(known).filter.gaussian[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)  # sums in another order
    np.testing.assert_allclose(rows[-1].attitude_deg, same[-1].attitude_deg, atol=1e-9)
    np.testing.assert_allclose(
        np.array(rows[-1].attitude_deg)[1:], (flight.truth_deg + turned_deg(LAST, both))[1:], atol=0.02
    )


def test_a_tail_whose_successor_failed_is_flown(flight):
    known = chain_of()
    reports = {15: (reported(flight),), 30: (reported(flight, 2, ()),)}
    flown(flight, {5: (released(flight),), 16: (released(flight, 2, NEXT),), **reports})
    flown(known, {5: (applied(known),)})
    assert_same(flight, known)


@pytest.mark.parametrize("is_taken", [True, False])
def test_until_its_report_a_successor_may_or_may_not_have_taken_the_place(flight, is_taken):
    announced = (*SLEW[:2], *NEXT) if is_taken else SLEW
    inputs = {5: (released(flight),), 15: (reported(flight),), 16: (released(flight, 2, NEXT),)}
    rows = flown(flight, inputs, announced=announced)
    position = 11
    assert state_of(flight).filter.mean[position] == pytest.approx(float(is_taken), abs=0.15)
    turned = (flight.truth_deg + turned_deg(LAST, announced))[1:]
    np.testing.assert_allclose(np.array(rows[-1].attitude_deg)[1:], turned, atol=0.02)
    assert not any("unannounced_motion" in row.inhibitions for row in rows)


def test_an_alignment_after_both_reports_knows_what_was_left_out(flight):
    known = chain_of()
    for one in (flight, known):
        one.documents.alignments[2] = PAYLOAD.alignment(one.at(9), 2, angles_deg=one.truth_deg.tolist())
    both = (*SLEW[:2], *NEXT)
    inputs = {5: (released(flight),), 16: (released(flight, 2, NEXT),)}
    reports = (reported(flight, 2, NEXT), reported(flight))
    flown(flight, {**inputs, 18: (*reports, AlignmentSet(2))}, announced=both)
    at_once = (reported_at_once(known, SLEW[:2]), reported_at_once(known, NEXT))
    flown(known, {5: at_once[:1], 16: at_once[1:], 18: (AlignmentSet(2),)}, announced=both)
    for one, other in zip(state_of(flight).filter.gaussian[:2], state_of(known).filter.gaussian[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_corrections_and_late_rows_between_release_and_report_are_kept(flight):
    known = chain_of()
    turn = Correction(flight.at(14), flight.at(30), Axes(0.0, 0.03, 0.0))
    for one, first, second in ((flight, released(flight), reported(flight)), (known, applied(known), None)):
        flown(one, {5: (first,), 12: (turn,)}, last=15)
        one.robust(one.row(13.5))
        for minute in range(16, 32):
            if minute == 25 and second is not None:
                one.chain.update(second)
            one.robust(one.row(minute, one.truth_deg + turned_deg(minute)))
    assert_same(flight, known)


def disturbance(flight):
    """Return the torque that acts at the newest row."""
    found, model = flight.chain._runners[0]._last
    return known_disturbance(found.torque_deg_h2, model, found.row.epoch_us)


def test_another_statement_about_the_craft_between_release_and_report_is_kept(flight):
    known = chain_of()
    onboard = Onboard(fast_loop=True, forecast_mode=True, roll_yaw_coupling=False, residual_torque_n_m=5e-7)
    stated = SpacecraftChange(replace(flight.spacecraft, onboard=onboard), 2)
    flown(flight, {5: (released(flight),), 12: (stated,), 30: (reported(flight),)})
    flown(known, {5: (applied(known),), 12: (stated,)})
    assert_same(flight, known)
    assert disturbance(flight) is not None


def test_an_alignment_between_release_and_report_begins_with_what_is_still_uncertain(flight):
    known = chain_of()
    for one, first, second in ((flight, released(flight), reported(flight)), (known, applied(known), None)):
        one.documents.alignments[2] = PAYLOAD.alignment(
            one.at(15), 2, angles_deg=(one.truth_deg + turned_deg(15)).tolist()
        )
        inputs = {5: (first,), 16: (AlignmentSet(2),), 30: () if second is None else (second,)}
        flown(one, inputs)
    assert_same(flight, known)


def test_a_command_that_is_over_at_the_alignment_is_part_of_it(flight):
    aligned = chain_of()
    for one in (flight, aligned):
        one.documents.alignments[2] = PAYLOAD.alignment(one.at(30), 2)
    flown(flight, {5: (released(flight),), 31: (AlignmentSet(2),), 33: (reported(flight),)}, announced=())
    flown(aligned, {31: (AlignmentSet(2),)}, announced=())
    assert_same(flight, aligned)


def test_before_the_alignment_a_release_waits_for_it():
    flight, known = (chain_of(is_opened=False) for _ in range(2))
    for one, first in ((flight, released(flight)), (known, applied(known))):
        for content in (*one.opening()[:-1], first, one.opening()[-1]):
            one.chain.update(content)
    flown(flight, {20: (reported(flight),)})
    flown(known, {})
    assert_same(flight, known)


def test_after_too_many_rows_the_powers_have_told_and_a_report_is_no_news(flight, monkeypatch):
    monkeypatch.setattr(robust_runner, "MAX_ROWS", 20)
    rows = flown(flight, {5: (released(flight),), 33: (reported(flight),)})
    assert state_of(flight).released == ()
    assert flight.chain._runners[0]._branch is None
    np.testing.assert_allclose(
        np.array(rows[-1].attitude_deg)[1:], (flight.truth_deg + turned_deg(LAST))[1:], atol=0.02
    )


def test_a_command_of_more_than_a_week_ago_is_forgotten(flight):
    runner = flight.chain._runners[0]
    flown(flight, {5: (released(flight),)}, last=10)
    start_us = flight.at(0) + 9 * 24 * HOUR
    flight.robust(flight.payload.measurement(start_us, power_dbm=np.full(16, np.nan)))
    flight.chain.update(Correction(start_us, start_us + 1, ZERO))
    assert runner._open == {}


# ---- the torque that acts -------------------------------------------------------------------------------------------


def test_the_disturbance_is_told_as_a_torque_with_its_sigma():
    pushed = PAYLOAD.spacecraft()
    flight = chain_of(spacecraft=replace(pushed, onboard=replace(pushed.onboard, residual_torque_n_m=5e-7)))
    flown(flight, {}, last=1, announced=())
    announced = disturbance(flight)
    assert (announced.epoch_us, announced.period_s) == (flight.at(1), 86_400.0)
    np.testing.assert_allclose(announced.sigma_n_m, 5e-7, rtol=1e-3)
    # 2e-7 N m of roll, most of it learned in three hours
    for minute in range(2, 181, 2):
        angles = np.array([0.0, 0.5 * np.degrees(2e-7 / INERTIA[0][0]) * (60.0 * minute) ** 2, 0.0])
        flight.robust(flight.row(minute, flight.truth_deg + angles))
    announced = disturbance(flight)
    assert announced.torque_n_m(announced.epoch_us).roll == pytest.approx(2e-7, abs=3.0 * announced.sigma_n_m.roll)
    assert announced.sigma_n_m.roll < 2e-7


def test_a_twentieth_too_little_fed_forward_is_learned_about_pitch_and_known_about_roll():
    """Roll and pitch wave in phase; only pitch has shown anything, and roll's torque is told with it."""
    record, start_us = PAYLOAD.spacecraft(), chain_of().at(0)
    cosine = AxisTorques(0.0, 1e-5, 7e-6)
    fed = replace(record.onboard, fed_forward_torque=FedForwardTorque(start_us, cosine_n_m=cosine))
    flight = chain_of(spacecraft=replace(record, onboard=fed))
    around = 2.0 * np.pi / 86_400.0

    def fly(minutes):
        for minute in minutes:
            turned = np.degrees(0.05 * np.array([0.0, 1e-5, 7e-6]) / np.array([1.0, INERTIA[0][0], INERTIA[1][1]]))
            swept = (1.0 - np.cos(around * 60.0 * minute)) / around**2
            flight.robust(flight.row(minute, flight.truth_deg + np.array([0.0, 1.0, 1.0]) * turned * swept))

    fly(range(2, 181, 2))
    announced = disturbance(flight)
    torque = announced.torque_n_m(announced.epoch_us)
    expected = 0.05 * np.cos(around * 60.0 * 180.0)
    assert torque.pitch / 7e-6 == pytest.approx(expected, abs=3.0 * announced.sigma_n_m.pitch / 7e-6)
    assert torque.roll / 1e-5 == pytest.approx(torque.pitch / 7e-6, abs=0.02)
    assert announced.sigma_n_m.pitch < 0.02 * 7e-6
    assert announced.sigma_n_m.roll < 0.02 * 1e-5
    # two hours on, and six hours from there: the wave goes round in the direction of time
    fly(range(182, 301, 2))
    announced = disturbance(flight)
    expected = 0.05 * np.cos(around * 60.0 * 300.0 + np.pi / 2.0)
    assert announced.torque_n_m(announced.epoch_us + 6 * HOUR).pitch / 7e-6 == pytest.approx(expected, abs=0.01)
    # of a torque of unknown shape less is known
    unshaped = chain_of(spacecraft=replace(record, onboard=replace(record.onboard, residual_torque_n_m=5e-7)))
    flown(unshaped, {}, last=1, announced=())
    assert disturbance(unshaped).sigma_n_m.yaw > announced.sigma_n_m.yaw


def test_a_torque_that_was_called_none_is_told_as_none(flight):
    flown(flight, {}, last=3)
    told = disturbance(flight)
    assert np.abs([told.constant_n_m, told.cosine_n_m, told.sine_n_m]).max() < 1e-10
    assert max(told.sigma_n_m) <= 1e-8


def test_a_ninth_unreported_command_is_one_share_more():
    flight = chain_of()
    flown(flight, {}, last=4)
    size = len(state_of(flight).filter.mean)
    for counter in range(1, 13):
        flight.chain.update(released(flight, counter))
        row = flight.robust(flight.row(4 + counter))
        assert row.status is Status.ACQUIRED
        assert len(state_of(flight).released) == len(state_of(flight).filter.mean) - size == counter
