"""Drives the release as a service would: rows every minute, persons, reports; and judges it by rules of its own."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from release_storage import CRAFT

from service.core.control.sign_check import SignState
from service.core.control.slew_schedule import Drive, Envelope, plan_slew, predicted_effect
from service.pipeline.control.release.advance import advance, restored
from service.pipeline.control.release.command_states import CommandTransition
from service.pipeline.control.release.events import (
    Automatic,
    Confirm,
    Engage,
    Event,
    InputsChanged,
    Order,
    OrderKind,
    Prepare,
    PublishEffect,
    ReleaseState,
    Report,
    ResponseJudged,
    RowSeen,
    SignJudged,
    Step,
    Tick,
    UplinkEffect,
)
from service.pipeline.control.release.interlock import Instant
from service.pipeline.control.release.interlock_conditions import InterlockInputs, InterlockRow, ReleaseSettings
from service.pipeline.control.release.release_checks import proposed
from service.records.levels.attitude import Axes
from service.records.operations.release import Purpose

US = 1_000_000
MINUTE_US = 60 * US
START_US = 1_900_000_000 * US
#: inertia about yaw, roll, pitch
INERTIA = np.diag([2600.0, 2600.0, 1400.0])
DRIVE = Drive(0.05, 0.002, 0.1, 0.001)
SETTINGS = ReleaseSettings()
INPUTS = InterlockInputs(
    is_aligned=True,
    ephemeris_received_us=START_US - 3600 * US,
    ephemeris_stop_us=START_US + 90 * 86_400 * US,
    calibration_id=7,
    plan_id=3,
    spacecraft_version=1,
    momentum_share=0.2,
)
GOOD = InterlockRow(
    epoch_us=START_US,
    period_s=60.0,
    attitude_deg=Axes(0.05, 0.02, -0.03),
    redundancy=9,
    is_yaw_allowed=True,
    balance_axes=(True, True, True),
)
#: angles that may be wrong in kind; what was learned before them goes on
DOUBT = replace(GOOD, is_fading=True, inhibitions=("downlink_fade",))


@lru_cache
def slew(yaw_deg: float, roll_deg: float, pitch_deg: float, horizon_s: float) -> tuple[tuple, object]:
    """Return pulses and effect of a slew."""
    pulses = plan_slew([yaw_deg, roll_deg, pitch_deg], [0.0, 0.0, 0.0], INERTIA, horizon_s, DRIVE)
    return pulses, predicted_effect(pulses, INERTIA, np.eye(3), horizon_s)


class ReleaseDriver:
    """One spacecraft's release, its clocks and what has gone out."""

    def __init__(self, settings: ReleaseSettings = SETTINGS) -> None:
        self.settings = settings
        self.state = ReleaseState()
        self.now_us, self.steady_us = START_US, 5 * US
        self.row: InterlockRow | None = None
        self.inputs = InterlockInputs()
        #: counter, instant, effect
        self.released: list[tuple[int, int, object]] = []
        self.alarms: list[str] = []
        #: whether something has tripped since the last reset, by the driver's own account
        self.is_tripped = False
        #: by the steady clock: ten good minutes are minutes that pass, whatever is done to the wall clock
        self.last_bad_us = self.steady_us

    @property
    def at(self) -> Instant:
        return Instant(self.now_us, self.steady_us)

    @property
    def name(self) -> str:
        return self.state.interlock.state.name

    def pass_time(self, seconds: float) -> None:
        self.now_us += round(seconds * US)
        self.steady_us += round(seconds * US)

    def jump_clock(self, seconds: float) -> None:
        """Move the clock alone; before the first event, and forwards after a restart, nobody can tell."""
        self.now_us += round(seconds * US)
        clock = self.state.interlock.clock
        is_seen = clock is not None and (clock.steady_us is not None or seconds < 0.0)
        self.is_tripped |= is_seen and abs(seconds) > self.settings.clock_jump_s

    def send(self, event: Event) -> Step:
        """Handle an event and hold the laws: refused means unchanged, released means nothing stood in the way."""
        before = self.state
        step = advance(before, event, self.settings)
        if step.refusal is not None:
            tick = advance(before, Tick(self.at), self.settings)
            assert step.state == tick.state, "an illegal event changed more than time does"
            assert step.effects == tick.effects, "an illegal event did something"
            if self.is_bad():
                self.last_bad_us = self.steady_us
            self.alarms += [each.warning for each in step.effects if isinstance(each, PublishEffect) and each.warning]
            self.state = step.state
            assert step.refusal.code
            assert step.refusal.detail
            return step
        if isinstance(event, RowSeen) and (self.row is None or event.row.epoch_us > self.row.epoch_us):
            self.row = event.row
        if isinstance(event, InputsChanged):
            self.inputs = event.inputs
            self.is_tripped |= event.inputs.lease_holders > 1 or (event.inputs.momentum_share or 0.0) > 0.8
        if isinstance(event, ResponseJudged):
            self.is_tripped |= event.log_ratio > 9.0
        if isinstance(event, SignJudged):
            self.is_tripped |= event.verdict in (SignState.MINUS, SignState.NOTHING)
        if isinstance(event, Order):
            self.is_tripped = (self.is_tripped or event.kind is OrderKind.STOP) and event.kind is not OrderKind.RESET
        # before the event is looked at, and with what it told
        if self.is_bad():
            self.last_bad_us = self.steady_us
        for effect in step.effects:
            if isinstance(effect, UplinkEffect):
                self._judge_release(step.state, effect.product.counter)
            if isinstance(effect, PublishEffect) and effect.warning:
                self.alarms.append(effect.warning)
        self.state = step.state
        return step

    def is_bad(self) -> bool:
        """Facts that forbid every correction of an angle."""
        row = self.row
        is_doubted = row is None or bool(set(row.inhibitions) - {"beyond_validity"}) or row.is_fading
        return is_doubted or row.redundancy < 2 or self.is_forbidden()

    def is_forbidden(self) -> bool:
        """Facts that forbid every torque, the balance of the known one too."""
        row, inputs = self.row, self.inputs
        if row is None or not inputs.is_aligned or inputs.has_inhibiting_operation or inputs.lease_holders > 1:
            return True
        age_s = (self.now_us - row.epoch_us) / US
        burn_us = inputs.burn_stop_us
        return (
            abs(age_s) > 3.0 * row.period_s + 30.0
            or not (abs(row.attitude_deg.roll) <= 2.0 and abs(row.attitude_deg.pitch) <= 2.0)
            or (inputs.momentum_share or 0.0) > 0.8
            or inputs.ephemeris_stop_us is None
            or inputs.ephemeris_stop_us - self.now_us < 6 * 3600 * US
            or (burn_us is not None and inputs.ephemeris_received_us <= burn_us <= self.now_us)
        )

    def _judge_release(self, state: ReleaseState, counter: int) -> None:
        """Hold what must be true of every torque that goes out."""
        command = next(each for each in state.commands if each.counter == counter)
        if command.purpose is Purpose.BALANCE:
            assert not self.is_forbidden(), "balanced while a reason stands that forbids it"
            assert any(self.row.balance_axes), "balanced what the estimator does not know any more"
        else:
            assert not self.is_bad(), "released while a reason stands"
            assert self.steady_us - self.last_bad_us >= 600 * US, "released before ten good minutes"
        assert not self.is_tripped, "released after a trip"
        assert counter not in [each for each, _, _ in self.released], "released twice"
        gross = np.array(command.gross_impulse_n_m_s)
        assert (gross <= 0.02 + 1e-12).all(), "beyond the impulse of a command"
        assert max(map(abs, command.peak_angle_deg)) <= 0.2 + 1e-9
        assert max(map(abs, command.peak_rate_deg_s)) <= 3e-4 + 1e-12
        self.released.append((counter, self.now_us, command))
        hour = [np.array(e.gross_impulse_n_m_s) for _, t, e in self.released if self.now_us - t < 3600 * US]
        assert (np.sum(hour, axis=0) <= 0.1 + 1e-9).all(), "beyond the impulse of an hour"

    def proposal(
        self,
        roll_deg: float = 0.02,
        *,
        yaw_deg: float = 0.0,
        pitch_deg: float = 0.0,
        horizon_s: float = 900.0,
        purpose: Purpose = Purpose.CONTROL,
    ):
        """Return a command computed from the newest row, to begin in eleven minutes."""
        pulses, effect = slew(yaw_deg, roll_deg, pitch_deg, horizon_s)
        epoch_us = self.row.epoch_us if self.row else self.now_us
        return proposed(CRAFT, epoch_us, self.now_us + 660 * US, pulses, effect, None, reason="test", purpose=purpose)

    def rows(self, count: int, row: InterlockRow = GOOD, lag_s: float = 10.0) -> None:
        """Let rows come, one a minute."""
        for _ in range(count):
            self.pass_time(60.0)
            self.send(RowSeen(self.at, replace(row, epoch_us=self.now_us - round(lag_s * US))))

    def report(self, **changes: object) -> Step:
        return self.send(InputsChanged(self.at, replace(self.inputs, **changes)))

    def order(self, kind: OrderKind, by: str = "ann") -> Step:
        return self.send(Order(self.at, by, kind))

    def engage(self, by: str, hours: float = 6.0, is_approver: bool = True, until_us: int | None = None) -> Step:
        until = START_US + round(hours * 3600 * US) if until_us is None else until_us
        return self.send(Engage(self.at, by, until, Envelope(), is_approver))

    def prepare(self, by: str = "ann", **request: float) -> Step:
        return self.send(Prepare(self.at, by, self.proposal(**request)))

    def confirm(self, by: str = "bob", counter: int | None = None, is_approver: bool = True) -> Step:
        command = self.state.commands[-1] if counter is None else self.command(counter)
        return self.send(Confirm(self.at, by, command.counter, command.digest, is_approver))

    def automatic(self, *, is_reported: bool = True, **request: float) -> Step:
        """Let the law send; the centre reports at once."""
        step = self.send(Automatic(self.at, self.proposal(**request)))
        if is_reported and any(isinstance(effect, UplinkEffect) for effect in step.effects):
            self.send(Report(self.at, self.state.commands[-1].counter, CommandTransition.EXECUTED))
        return step

    def command(self, counter: int):
        return next(each for each in self.state.commands if each.counter == counter)

    def tick(self, seconds: float = 0.0) -> Step:
        self.pass_time(seconds)
        return self.send(Tick(self.at))

    def forget(self, axis: str) -> None:
        """Make the sign of an axis unproven."""
        others = tuple(each for each in self.state.interlock.proven_axes if each != axis)
        self.state = replace(self.state, interlock=replace(self.state.interlock, proven_axes=others))

    def restart(self) -> None:
        """Kill the process: what is stored comes back, the steady clock begins again, facts must be told again."""
        self.state = restored(self.state)
        self.row = None
        self.steady_us = 0
        self.last_bad_us = self.steady_us

    def armed(self) -> "ReleaseDriver":
        """Bring control to ARMED with the signs of all axes proven."""
        self.send(InputsChanged(self.at, INPUTS))
        self.rows(11)
        self.order(OrderKind.ARM)
        for axis in ("yaw", "roll", "pitch"):
            self.send(SignJudged(self.at, axis, SignState.PLUS))
        assert self.name == "ARMED"
        return self

    def engaged(self) -> "ReleaseDriver":
        """Bring control to ENGAGED by two persons."""
        self.armed()
        self.engage("ann")
        self.engage("bob")
        assert self.name == "ENGAGED"
        return self
