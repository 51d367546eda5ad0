"""Drives the release service, over an archive in memory, and judges what went out by rules of its own."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
from release_storage import SC, FakeArchive, KilledError

from service.core.control.sign_check import SignState
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import (
    NO_CARRY,
    basis_at,
    basis_of,
    compute_command,
    with_executed,
)
from service.pipeline.control.release.control_verdict import ControlVerdict, ControlView, control_verdict
from service.pipeline.control.release.events import OrderKind, SignJudged, StoredRow
from service.pipeline.control.release.interlock_conditions import ReleaseSettings
from service.ports.archive import Outcome
from service.ports.storage import ClockReading
from service.records.catalogue import Method
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import AttitudeRow, Axes, BalanceBasis, Disturbance, Status, TorqueCommand
from service.records.operations.release import Command, CommandRequest, Purpose
from service.runtime.control.release_context import ReleasePublisher
from service.runtime.control.release_service import ReleaseService
from service.runtime.live.live_feed import LiveFeed

US = 1_000_000
MINUTE_US = 60 * US
START_US = 1_900_000_000 * US
#: reasons of the estimator that the interlock judges itself
OWN = {"beyond_validity", "sigma_roll", "sigma_pitch"}
GOOD = AttitudeRow(
    epoch_us=START_US,
    received_at_us=START_US,
    number=1,
    method=Method.ROBUST,
    attitude_deg=Axes(0.02, 0.06, -0.03),
    sigma_deg=Axes(0.08, 0.02, 0.03),
    rates_deg_s=Axes(0.0, 0.0, 0.0),
    status=Status.ACQUIRED,
    control_allowed=True,
    control_allowed_axes=(True, True, True),
    inhibitions=(),
    carriers_used=12,
    excluded=(),
    downlink_fade=False,
    downlink_fade_db=0.0,
    common_db=0.0,
    residual_rms_db=0.1,
    calibration_id=7,
    alignment_id=1,
)


class FakeClock:
    """A clock that tests set, and one that they cannot set by mistake."""

    def __init__(self) -> None:
        self.now, self.steady, self.is_of_data = START_US, 5 * US, False

    def reading(self, spacecraft, newest_epoch_us):
        return ClockReading(self.is_of_data, self.now)

    def now_us(self, spacecraft_id):
        return self.now

    def system_us(self):
        return self.now

    def is_data(self, spacecraft_id):
        return self.is_of_data


class ReleaseServiceDriver:
    """One spacecraft's release service, its clocks, its archive and its persons."""

    def __init__(self, settings: ReleaseSettings | None = None, **arguments: object) -> None:
        self.archive, self.clock = FakeArchive(START_US), FakeClock()
        self.settings, self._arguments = settings or ReleaseSettings(), arguments
        self.row: AttitudeRow | None = None
        self.basis: BalanceBasis | None = None
        self.disturbance: Disturbance | None = None
        self.notified: list[str] = []
        #: instant and command of each release that was stored
        self.released: list[tuple[int, Command]] = []
        #: by the steady clock, as the ten good minutes are
        self.last_bad_us = self.clock.steady
        self.start()

    def start(self) -> None:
        """Start the service on what is stored."""
        publisher = ReleasePublisher(self.archive.audit, LiveFeed(), self.notified.append)
        self.service = ReleaseService(
            self.archive,
            self.clock,
            self.settings,
            TorqueConfig(),
            publisher,
            steady_us=lambda: self.clock.steady,
            **self._arguments,
        )

    def restart(self) -> None:
        """Kill the service and start it again."""
        self.clock.steady, self.row, self.basis, self.last_bad_us = 0, None, None, 0
        self.start()

    @property
    def releases(self):
        return self.archive.releases

    @property
    def view(self) -> ControlView:
        return self.service.control(SC)

    @property
    def verdict(self) -> ControlVerdict:
        return control_verdict(self.view, self.command or self.row)

    @property
    def command(self) -> TorqueCommand | None:
        """The command of the newest row, by the catalogue as it is now."""
        if self.row is None:
            return None
        given = self.row, self.archive.record, NO_CARRY, 60.0, TorqueConfig(), self.disturbance
        return compute_command(*given, basis=self.basis).command

    @property
    def codes(self) -> tuple[str, ...]:
        return tuple(reason.code for reason in self.view.reasons)

    @property
    def state(self) -> str:
        return self.view.state

    def pass_time(self, seconds: float) -> None:
        self.clock.now += round(seconds * US)
        self.clock.steady += round(seconds * US)

    def rows(self, count: int = 1, lag_s: float = 10.0, evidence: object = None, **change: object) -> None:
        """Let rows come, one a minute."""
        for _ in range(count):
            self.pass_time(60.0)
            epoch_us = self.clock.now - round(lag_s * US)
            self.row = replace(GOOD, epoch_us=epoch_us, number=epoch_us // US, **change)
            self.on_rows(evidence=evidence)

    def on_rows(self, *others: AttitudeRow, applied=None, evidence=None) -> None:
        """Hand the newest row over, beside those of other methods."""
        self.note()
        if self.row.control_allowed:
            self.basis = basis_of(self.row, self.disturbance)
        elif self.basis is not None:
            self.basis = basis_at(self.basis, self.row, self.archive.record, TorqueConfig().hold_s)
        command = self.command if applied is None else applied.command
        outcome = Outcome((self.row, *others), command, applied, self.disturbance)
        self.service.on_rows(SC, [StoredRow(outcome, evidence)])
        self.judge()

    def tell(self, **facts: object) -> None:
        """Change what the archive says."""
        for name, value in facts.items():
            setattr(self.archive, name, value)
        self.service.on_rows(SC, [], has_inputs=True)
        self.note()

    def momentum(self, n_m_s: float, records: int = 2) -> None:
        """Send the last second's records; one alone trips nothing."""
        for back_us in range(records - 1, -1, -1):
            record = TelemetryRecord(self.clock.now - back_us, wheel_momentum_n_m_s=(n_m_s, 0.0, 0.0))
            self.archive.telemetry.append(record)
        self.tell()
        # the release loop looks at what was told each second; a fact that comes and goes in between is not judged
        self.service.tick()

    def order(self, kind: OrderKind, by: str = "ann") -> ControlView:
        return self.service.order(SC, kind, by)

    def prepare(self, by: str = "ann", **wish: object) -> Command:
        return self.service.prepare(SC, by, CommandRequest("test", **wish))

    def confirm(self, command: Command, by: str = "bob", *, is_approver: bool = True, digest: str = "") -> Command:
        self.note()
        try:
            return self.service.confirm(SC, command.counter, by, digest or command.digest, is_approver=is_approver)
        finally:
            self.judge()

    def report(self, counter: int, turn: str = "executed", **reported: object) -> Command:
        command = self.service.report(SC, counter, turn, by="centre", **reported)
        if self.basis is not None:
            self.basis = with_executed(self.basis, command.executed)
        return command

    def engage(self, by: str, hours: float = 6.0, *, is_approver: bool = True) -> ControlView:
        until_us = self.clock.now + round(hours * 3600 * US)
        return self.service.engage(SC, by, is_approver=is_approver, until_us=until_us)

    def prove(self, *axes: str) -> None:
        """Let sign checks have proven some axes."""
        release = self.service._release(SC)
        for axis in axes:
            at = self.service._instant(release)
            release.handle(SignJudged(at, axis, SignState.PLUS))

    def armed(self) -> "ReleaseServiceDriver":
        self.rows(12)
        self.order(OrderKind.ARM)
        self.prove("roll", "pitch")
        assert self.state == "ARMED"
        return self

    def engaged(self) -> "ReleaseServiceDriver":
        self.armed()
        self.engage("ann")
        self.engage("bob")
        assert self.state == "ENGAGED"
        return self

    def sent(self) -> Command:
        """Bring a command out by two persons."""
        return self.confirm(self.prepare())

    def killed_at(self, moment: str, act) -> None:
        """Kill the service before or after it has stored what an act leads to, and start it again."""
        self.releases.kill = moment
        with suppress(KilledError):
            act()
        self.releases.kill = None
        self.judge()
        self.restart()

    def is_bad(self) -> bool:
        """Facts that forbid every correction of an angle."""
        row = self.row
        own = OWN | {"protection_level"} if self.is_sign_certain(0.4) else OWN
        is_doubted = row is None or bool(set(row.inhibitions) - own) or row.downlink_fade or row.carriers_used < 5
        return is_doubted or self.is_forbidden()

    def size_deg(self) -> float:
        """Greater of roll and pitch; infinite where one is not known."""
        sizes = [abs(self.row.attitude_deg.roll), abs(self.row.attitude_deg.pitch)]
        return math.inf if any(map(math.isnan, sizes)) else max(sizes)

    def is_sign_certain(self, beyond_deg: float) -> bool:
        """Certainty of the sign: roll or pitch is beyond an angle, and exceeds its protection level where it is."""
        if self.row is None or not self.size_deg() > beyond_deg:
            return False
        angle, level = self.row.attitude_deg, self.row.protection_deg
        pairs = ((abs(angle.roll), level.roll), (abs(angle.pitch), level.pitch))
        return all(level_deg < angle_deg for angle_deg, level_deg in pairs if angle_deg > beyond_deg)

    def is_forbidden(self) -> bool:
        """Facts that forbid every torque, the balance of the known one too."""
        row, archive = self.row, self.archive
        if row is None or not archive.is_aligned or archive.operations:
            return True
        # older telemetry says nothing of the present
        fresh = [one for one in archive.telemetry if self.clock.now - one.epoch_us <= 600 * US]
        reported = fresh[-1] if fresh else None
        is_full = reported is not None and abs(reported.wheel_momentum_n_m_s[0]) > 16.0
        age_s = (self.clock.now - row.epoch_us) / US
        return (
            abs(age_s) > 3.0 * 60.0 + 30.0
            or not (self.size_deg() <= 2.0 or self.is_sign_certain(2.0))
            or is_full
            or archive.ephemeris_stop_us - self.clock.now < 6 * 3600 * US
        )

    def note(self) -> None:
        """Keep when something last stood in the way."""
        if self.is_bad():
            self.last_bad_us = self.clock.steady

    def judge(self) -> None:
        """Hold what must be true of everything that was stored as released since the last look."""
        fresh = self.releases.released[len(self.released) :]
        known = {view.counter for _, view in self.released}
        for entry in fresh:
            view = self.releases.views[entry.counter]
            assert entry.counter not in known, "sent twice"
            known.add(entry.counter)
            if view.purpose is Purpose.BALANCE:
                assert not self.is_forbidden(), "balanced while a reason stands that forbids it"
                assert set(self.row.inhibitions) <= {"downlink_fade", "chain_step", "no_fix", "sigma_roll"}
            else:
                assert not self.is_bad(), "released while a reason stands"
                assert self.clock.steady - self.last_bad_us >= 600 * US, "released before ten good minutes"
            assert view.confirmed_by != view.prepared_by or view.is_automatic, "released by one person"
            assert max(map(abs, view.gross_impulse_n_m_s)) <= 0.02 + 1e-12, "beyond the impulse of a command"
            assert view.start_us >= self.clock.now + 150 * US, "begins before the uplink can bring it"
            self.released.append((self.clock.now, view))
            hour = [np.array(v.gross_impulse_n_m_s) for t, v in self.released if self.clock.now - t < 3600 * US]
            assert (np.sum(hour, axis=0) <= 0.1 + 1e-9).all(), "beyond the impulse of an hour"
        unreported = [v for v in self.releases.views.values() if v.state in ("RELEASED", "SENT")]
        assert len(unreported) <= 1, "two commands without a report"
