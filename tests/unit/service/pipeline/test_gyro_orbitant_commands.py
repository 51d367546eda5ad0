"""The gyro-orbitant law as a choice of the catalogue: commands, refusals, a closed loop, and the chain."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import Flight, FlightPayload

from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.core.control.slew_schedule import Envelope, envelope_excesses
from service.core.geometry.frames import body_from_nadir
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import NO_CARRY, command_for, compute_command
from service.pipeline.control.release.release_checks import effect_of_law
from service.records.catalogue import ControlLaw, FlexibleMode, GyroOrbitantGains, Method, Release
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import Axes, row_without_attitude

S = 1_000_000
PAYLOAD = FlightPayload.make()
W0 = GEOSTATIONARY_RATE_RAD_S
W0_DEG_S = math.degrees(W0)
EPOCH = 1_800_000_000 * S
AT_REST = Axes(0.0, 0.0, -W0_DEG_S)
#: x roll, y pitch, z yaw
INERTIA = np.array(PAYLOAD.spacecraft().inertia_kg_m2)
#: deg/h in deg/s
DEG_H = 1.0 / 3600.0


def gains_of(period_s):
    """Return gains whose roll and pitch loops have some period."""
    roll, pitch, yaw = INERTIA.diagonal()
    w = 2.0 * math.pi / period_s
    k2 = 1.8 * w
    yaw_n_m = math.sqrt(2.0) * 0.25 * w * yaw * k2
    return GyroOrbitantGains(2.0 * roll * w**2, roll * k2, 2.0 * pitch * w**2, pitch * k2, yaw_n_m, yaw * k2)


def craft_of(release=Release.AUTOMATIC, period_s=1200.0, **changes):
    reported = {"law": ControlLaw.GYRO_ORBITANT, "gyro_orbitant": gains_of(period_s), **changes}
    return PAYLOAD.spacecraft(release=release, **reported)


def row(attitude=(0.3, 0.1, -0.1), allowed=(True, True, True), epoch_us=EPOCH, **changes):
    plain = row_without_attitude(epoch_us, epoch_us, 77, Method.ROBUST, ())
    angles = {"attitude_deg": Axes(*attitude), "rates_deg_s": None}
    return replace(plain, **angles, control_allowed=True, control_allowed_axes=allowed, **changes)


def command(of, record, rate=AT_REST, period_s=60.0, carry=NO_CARRY):
    return compute_command(of, record, carry, period_s, TorqueConfig(), body_rate_deg_s=rate)


# ---- commands -------------------------------------------------------------------------------------------------------


def test_roll_and_pitch_are_pushed_back_and_the_yaw_of_the_row_is_not_looked_at():
    reported = [command(row((yaw, 0.1, -0.1)), craft_of()).command for yaw in (0.3, -0.3)]
    assert reported[0] == reported[1]
    assert reported[0].control_allowed
    assert reported[0].torque_n_m.yaw == 0.0
    stiffness = gains_of(1200.0)
    # within the impulse of the shortest pulse, which is carried
    assert reported[0].torque_n_m.roll == pytest.approx(
        -0.5 * stiffness.roll_stiffness_n_m * math.radians(0.1), abs=4e-6
    )
    assert reported[0].torque_n_m.pitch == pytest.approx(
        0.5 * stiffness.pitch_stiffness_n_m * math.radians(0.1), abs=4e-6
    )


@pytest.mark.parametrize("yaw_deg", [0.3, -0.3])
def test_the_roll_rate_tells_yaw_and_its_torque_brings_it_back(yaw_deg):
    rate = Axes(0.0, -W0_DEG_S * math.radians(yaw_deg), -W0_DEG_S)
    reported = command(row((0.0, 0.0, 0.0)), craft_of(), rate, period_s=60.0, carry=np.zeros(3)).command
    wanted = -gains_of(1200.0).yaw_stiffness_n_m / math.sqrt(2.0) * math.radians(yaw_deg)
    assert reported.torque_n_m.yaw == pytest.approx(wanted, abs=4e-6)


REFUSED = {
    "no telemetry": (None, "no_body_rate"),
    "an axis is not told": (Axes(0.0, math.nan, -W0_DEG_S), "no_body_rate"),
    "a roll rate above the orbital rate": (Axes(0.0, 1.01 * W0_DEG_S, -W0_DEG_S), "law_beyond"),
    "a roll rate of which nu0 is imaginary": (Axes(0.0, -2.0 * W0_DEG_S, -W0_DEG_S), "law_beyond"),
    "it turns against its orbit": (Axes(0.0, 0.0, 0.1 * W0_DEG_S), "law_beyond"),
}


@pytest.mark.parametrize("release", list(Release))
@pytest.mark.parametrize("case", REFUSED)
def test_beyond_the_law_the_command_is_zero_and_says_why(case, release):
    rate, word = REFUSED[case]
    outcome = command(row(), craft_of(release, 14_400.0), rate, 900.0, np.ones(3))
    asked = command_for(row(), craft_of(release, 14_400.0), EPOCH, 900.0, None, TorqueConfig(), body_rate_deg_s=rate)
    for reported in (outcome.command, asked):
        assert (reported.inhibitions, reported.schedule, reported.control_allowed) == ((word,), (), False)
    assert not outcome.carry_n_m_s.any()


def test_reasons_of_the_row_make_a_missing_body_rate_no_news():
    assert command(row(inhibitions=("late",)), craft_of(), None).command.inhibitions == ("late",)


def test_commands_that_come_too_rarely_for_the_gains_are_zero():
    assert command(row(), craft_of(), period_s=60.0).command.control_allowed
    assert command(row(), craft_of(), period_s=600.0).command.inhibitions == ("no_law",)
    without = craft_of(gyro_orbitant=None)
    assert command(row(), without).command.inhibitions == ("no_law",)


def test_what_is_withheld_about_an_axis_stays_withheld():
    rate = Axes(0.0, -W0_DEG_S * 0.01, -W0_DEG_S)
    reported = command(row(allowed=(False, True, True)), craft_of(), rate).command
    assert reported.torque_n_m.yaw == 0.0
    assert reported.torque_n_m.roll != 0.0


@pytest.mark.parametrize("rate_deg_h", [0.1, 10.0])
def test_released_in_two_steps_a_command_stays_within_the_envelope_and_its_period(rate_deg_h):
    record = replace(craft_of(Release.TWO_STEP, 14_400.0), modes=(FlexibleMode("roll", 0.6, 0.003, 0.4),))
    rate = Axes(rate_deg_h * DEG_H, rate_deg_h * DEG_H, -W0_DEG_S - rate_deg_h * DEG_H)
    reported = command_for(row(), record, EPOCH, 3600.0, None, TorqueConfig(), body_rate_deg_s=rate)
    assert reported.command_period_s == 900.0
    assert reported.schedule
    assert reported.schedule_check is not None
    assert all(pulse.start_us + pulse.duration_s * S <= reported.valid_until_us for pulse in reported.schedule)
    assert envelope_excesses(effect_of_law(reported, record), (0.0, 0.0, 0.0), Envelope()) == ()
    assert reported.saturated is (rate_deg_h == 10.0)
    weak = command_for(row(), record, EPOCH, 3600.0, 0.002, TorqueConfig(), body_rate_deg_s=rate)
    assert max(abs(part) for pulse in weak.schedule for part in pulse.torque_n_m) == pytest.approx(0.002)


# ---- a closed loop --------------------------------------------------------------------------------------------------


class Body:
    """A rigid spacecraft in a geostationary orbit: x East, y South, z nadir; wheels, gravity gradient; steps of 5 s."""

    STEP_S = 5.0

    def __init__(self, attitude_deg, extra_deg_h):
        self.matrix = body_from_nadir(attitude_deg)
        yaw, roll, pitch = np.radians(np.array(extra_deg_h) * DEG_H)
        self.rate = self.matrix @ np.array([0.0, -W0, 0.0]) + np.array([roll, pitch, yaw])
        self.momentum, self.wheel = INERTIA @ self.rate, np.zeros(3)

    def angles_deg(self):
        m = self.matrix
        return np.degrees([math.atan2(m[0, 1], m[0, 0]), math.atan2(m[1, 2], m[2, 2]), -math.asin(m[0, 2])])

    def reported(self):
        x, y, z = np.degrees(self.rate).tolist()
        return Axes(z, x, y)

    def fly(self, impulse_n_m_s, duration_s):
        """Fly on, an impulse (yaw, roll, pitch) given in the first step."""
        yaw, roll, pitch = impulse_n_m_s
        self.wheel = self.wheel - np.array([roll, pitch, yaw])
        for _ in range(round(duration_s / self.STEP_S)):
            down = self.matrix[:, 2]
            gravity = 3.0 * W0**2 * np.cross(down, INERTIA @ down)
            self.momentum = self.momentum + self.STEP_S * (np.cross(self.momentum, self.rate) + gravity)
            self.rate = np.linalg.solve(INERTIA, self.momentum - self.wheel)
            x, y, z = self.STEP_S * (self.rate - self.matrix @ np.array([0.0, -W0, 0.0]))
            self.matrix = self.matrix - np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ self.matrix


def flown(body, record, hours):
    """Return the angles each minute (T, 3), commands every minute; without a spacecraft nothing is done."""
    carry, angles = NO_CARRY, []
    for minute in range(60 * hours):
        seen = body.angles_deg()
        impulse = np.zeros(3)
        if record is not None:
            # the estimator's yaw is wrong on purpose
            of = row((0.35, seen[1], seen[2]), epoch_us=EPOCH + 60 * minute * S)
            outcome = command(of, record, body.reported(), carry=carry)
            carry, impulse = outcome.carry_n_m_s, np.array(outcome.command.impulse_n_m_s)
            assert outcome.command.control_allowed
        body.fly(impulse, 60.0)
        angles.append(body.angles_deg())
    return np.array(angles)


@pytest.mark.parametrize("extra_deg_h", [(10.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, 10.0), (-6.0, -6.0, -6.0)])
def test_a_craft_that_turns_by_ten_degrees_an_hour_is_brought_to_rest(extra_deg_h):
    angles = flown(Body((0.0, 0.0, 0.0), extra_deg_h), craft_of(), 3)
    alone = flown(Body((0.0, 0.0, 0.0), extra_deg_h), None, 3)
    # a roll rate that no yaw makes is taken for one until it is gone: 9 deg/h of roll throw yaw by 3.6 deg
    assert (np.abs(angles).max(axis=0) < (4.0, 0.3, 0.3)).all()
    # the shortest pulse about roll is 0.016 deg/h, which tells 0.06 deg of yaw
    assert (np.abs(angles[-30:]).max(axis=0) < (0.08, 0.02, 0.02)).all()
    assert np.abs(alone[-1]).max() > 10.0


@pytest.mark.parametrize("yaw_deg", [1.0, -1.0])
def test_a_degree_of_yaw_that_nobody_measures_is_brought_back(yaw_deg):
    """Check 13 of the study: the restoring sign in the closed loop, on angles and rates in the service's axes."""
    angles = flown(Body((yaw_deg, 0.0, 0.0), (0.0, 0.0, 0.0)), craft_of(), 4)
    assert abs(angles[-1, 0]) < 0.05
    assert np.abs(angles[:, 1:]).max() < 0.4
    assert abs(flown(Body((yaw_deg, 0.0, 0.0), (0.0, 0.0, 0.0)), None, 4)[-1, 0]) > 0.4


# ---- the chain ------------------------------------------------------------------------------------------------------


def telemetry(flight, minute, rate=AT_REST):
    return TelemetryRecord(flight.at(minute), body_rate_deg_s=rate)


def commands(flight):
    """Return the commands of forty minutes in which telemetry comes, stops, exceeds the law and comes again."""
    reported = {minute: telemetry(flight, minute) for minute in (*range(5, 15), *range(25, 41))}
    reported[30] = telemetry(flight, 30, Axes(0.0, 2.0 * W0_DEG_S, -W0_DEG_S))
    found = {}
    for minute in range(1, 41):
        if minute in reported:
            flight.chain.update(reported[minute])
        if minute % 2:
            # momentum alone, and a rate of one axis, are no word of the body's rate
            flight.chain.update(TelemetryRecord(flight.at(minute) + S, wheel_momentum_n_m_s=(0.1, 0.0, 0.0)))
            flight.chain.update(telemetry(flight, minute + 0.1, Axes(math.nan, 0.0, 0.0)))
        found[minute] = flight.chain.step(flight.row(minute)).command
    return found


def test_the_chain_uses_the_newest_body_rate_while_it_is_fresh():
    found = commands(Flight(PAYLOAD, spacecraft=craft_of()))
    reasons = {minute: reported.inhibitions for minute, reported in found.items()}
    assert {reasons[minute] for minute in range(1, 5)} == {("no_body_rate",)}
    # fourteen and three and a half minutes
    assert {reasons[minute] for minute in range(5, 18)} == {()}
    assert {reasons[minute] for minute in range(18, 25)} == {("no_body_rate",)}
    assert reasons[30] == ("law_beyond",)
    assert {reasons[minute] for minute in (*range(25, 30), *range(31, 41))} == {()}
    assert found[6].schedule


def test_the_same_journal_gives_the_same_commands_to_the_last_bit():
    one, other = (commands(Flight(PAYLOAD, spacecraft=craft_of())) for _ in range(2))
    assert repr(one) == repr(other)
    by_error = {"law": ControlLaw.PROPORTIONAL_DERIVATIVE}
    assert repr(commands(Flight(PAYLOAD, spacecraft=craft_of(**by_error)))) != repr(one)
