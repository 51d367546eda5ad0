"""The ground of a flight: chain, release and interlock of the service, two persons on duty, the line to the spacecraft.

Nothing but the archive is replaced: rows, commands and reports pass the code that the service runs. The signs of all
axes count as proven before. The two persons arm control, authorise it for as long as the settings allow and renew that,
release single commands where roll or pitch is beyond 0.4 deg, and take control up again after a trip by a document that
the ground itself has changed. Any other trip stays until the end: no person is simulated who could find its cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import cast

from service.errors import NotFoundError
from service.pipeline.chain import Chain
from service.pipeline.config import TorqueConfig
from service.pipeline.control.release import events
from service.pipeline.control.release.command_states import MAY_RELEASE, OPEN, UNREPORTED, CommandTransition, State
from service.pipeline.control.release.interlock import Instant, Interlock
from service.pipeline.control.release.interlock_conditions import (
    Condition,
    InterlockInputs,
    ReleaseSettings,
    microseconds,
)
from service.ports.archive import ListPart
from service.ports.storage import Storage
from service.records.catalogue import ControlMode, Release
from service.records.epoch import US_PER_S
from service.records.inputs import SlowInput
from service.records.levels.attitude import AppliedCommand, Axes, Pulse, TorqueCommand
from service.records.levels.measurement import Measurement
from service.records.operations.release import (
    Command,
    CommandRequest,
    ProductForm,
    ReleaseChange,
    StoredRelease,
    UplinkProduct,
)
from service.runtime.control.release_context import (
    KnownFacts,
    ReleasePublisher,
    SpacecraftRelease,
    interlock_inputs,
)
from service.runtime.control.sign_checks import handle_row, judge_report, release_refusal, requested
from service.runtime.live.live_feed import LiveFeed
from service.study.closed_loop.controllers import Controller, ControllerOutput
from service.study.closed_loop.plant_process import CommandReport, SpacecraftTruth

#: a report later than this after the end of a schedule is given up, s
_REPORT_TIMEOUT_S = 60.0
_OPERATOR, _APPROVER = "operator", "approver"
#: trips by what the ground itself has done
_OWN_TRIPS = frozenset({Condition.CONFIGURATION})
_NOTHING_EXECUTED = frozenset({"late", "refused", "replaced"})


@dataclass
class FlightReleases:
    """Port `Releases` of one spacecraft for the length of a flight, as far as the release of rows needs it."""

    release: StoredRelease
    by_counter: dict[int, Command] = field(default_factory=dict)
    products: list[UplinkProduct] = field(default_factory=list)
    #: what the chain has not got yet
    changes: list[ReleaseChange] = field(default_factory=list)

    def stored(self, _spacecraft_id: str) -> StoredRelease:
        """Return the newest state."""
        return self.release

    def save(self, _spacecraft_id: str, version: int, change: ReleaseChange) -> int:
        """Keep a change."""
        self.release = StoredRelease(version + 1, change.document, change.holder)
        self.by_counter.update({command.counter: command for command in change.commands})
        self.products += change.products
        self.changes.append(change)
        return version + 1

    def command(self, _spacecraft_id: str, counter: int) -> Command:
        """Return one command; NotFoundError ``command.unknown``."""
        if counter not in self.by_counter:
            raise NotFoundError("command.unknown", f"no command {counter}")
        return self.by_counter[counter]

    def commands(self, _spacecraft_id: str, part: ListPart) -> list[Command]:
        """Return commands prepared in a window."""
        every, window = self.by_counter.values(), part.window
        return [each for each in every if window.start_us <= each.prepared_us < window.stop_us][: part.limit]

    def newest_product(self, _spacecraft_id: str, form: ProductForm) -> UplinkProduct | None:
        """Return the product of a form that was made last."""
        return next((each for each in reversed(self.products) if each.form is form), None)


@dataclass
class Centre(Controller):
    """Controller of a flight by the service.

    Parameters
    ----------
    chain : Chain
        With all documents of the spacecraft.
    settings : ReleaseSettings
        Of the interlock.
    torque : TorqueConfig
        Of the chain.
    """

    chain: Chain
    settings: ReleaseSettings
    torque: TorqueConfig
    #: conditions by which control has tripped
    trips: tuple[str, ...] = ()
    _command: TorqueCommand | None = None
    _now_us: int = 0
    _ephemeris_us: int = 0

    def __post_init__(self) -> None:
        facts = self._facts()
        state = events.ReleaseState(Interlock(inputs=facts.inputs, proven_axes=("yaw", "roll", "pitch")))
        self._releases = FlightReleases(StoredRelease(1, events.document_of(state), "flight"))
        storage = cast("Storage", SimpleNamespace(releases=self._releases))
        audit = SimpleNamespace(append=lambda _: None)
        publisher = ReleasePublisher(audit, LiveFeed(), lambda _: None)
        parts = storage, publisher, self.settings, self.torque, "flight"
        self._release = release = SpacecraftRelease(facts.spacecraft.id, *parts, known=facts)
        # signs are proven for the version that the interlock has seen
        proven = replace(release.state.interlock, inputs=facts.inputs)
        release.state = replace(release.state, interlock=proven)

    def on_ground(self, content: SlowInput) -> None:
        """Take an input of the journal."""
        ephemeris = self.chain.knowledge.ephemeris
        self.chain.update(content)
        if self.chain.knowledge.ephemeris is not ephemeris:
            self._ephemeris_us = self._now_us
        self._release.known = self._facts()

    def on_input(self, reports: Sequence[CommandReport]) -> None:
        """Take what the spacecraft has reported of commands."""
        for report in reports:
            if self._release.spacecraft.control.mode is ControlMode.ONBOARD:
                self._on_impulse(report)
            elif report.counter in self._releases.by_counter:
                self._on_report(report)
        self._journal()

    def decide(self, measurement: Measurement, truth: SpacecraftTruth) -> ControllerOutput:  # noqa: ARG002
        """Return what goes out after a row."""
        ((_, outcome, _, evidence),) = self.chain.rows([measurement])
        self._now_us = measurement.epoch_us
        if outcome is None:
            return ControllerOutput(is_inhibited=True)
        release, at, known = self._release, self._at(), len(self._releases.products)
        self._command = outcome.command or self._command
        inputs = interlock_inputs(release.facts, at.now_us, lease_holders=1, is_disagreeing=False)
        if inputs != release.state.interlock.inputs:
            release.handle(events.InputsChanged(at, inputs))
        stored = events.StoredRow(outcome, evidence())
        row = release.update(stored, release.spacecraft.control.method)
        if row is not None:
            handle_row(release, stored, row, at, may_send=True)
        self._give_up(at)
        self._on_duty(at)
        self._journal()
        if outcome.applied is not None:
            self.chain.update(outcome.applied)
        interlock = release.state.interlock
        schedule: tuple[Pulse, ...] = ()
        is_inhibited = interlock.state not in MAY_RELEASE
        if interlock.inputs.is_automatic and outcome.command is not None:
            schedule, is_inhibited = outcome.command.schedule, not outcome.command.control_allowed
        angles = None if row is None else row.steered_deg
        product = next(iter(self._releases.products[known:]), None)
        return ControllerOutput(schedule, is_inhibited, angles, interlock.reasons, product)

    def _facts(self) -> KnownFacts:
        known = self.chain.knowledge
        if known.spacecraft is None or known.ephemeris is None or known.plan is None:
            raise ValueError("a flight begins with spacecraft, ephemeris and plan")
        inputs = InterlockInputs(
            is_aligned=known.alignment is not None,
            ephemeris_received_us=self._ephemeris_us,
            ephemeris_stop_us=known.ephemeris.valid_stop_us,
            plan_id=known.plan.id,
            spacecraft_version=1,
            is_automatic=known.spacecraft.control.release is Release.AUTOMATIC,
        )
        telemetry, rated = (records[-1] if records else None for records in (known.momenta, known.rates))
        momenta = tuple(record.wheel_momentum_n_m_s or () for record in known.momenta[:-3:-1])
        return KnownFacts(known.spacecraft, inputs, tuple(known.operations.values()), telemetry, momenta, rated)

    def _at(self) -> Instant:
        return Instant(self._now_us, self._now_us)

    def _journal(self) -> None:
        """Hand new entries of the journal to the chain."""
        changes, self._releases.changes = self._releases.changes, []
        for change in changes:
            for entry in change.entries:
                self.chain.update(entry)

    def _on_impulse(self, report: CommandReport) -> None:
        """Take the mean torque of what the loop on board has done."""
        start_us, stop_us = report.executed_from_us, report.executed_until_us
        if report.state != "executed" or self._command is None or start_us is None or stop_us is None:
            return
        seconds = (stop_us - start_us) / US_PER_S
        pulse = Pulse(start_us, seconds, Axes(*(impulse / seconds for impulse in report.impulse_n_m_s)))
        self.chain.update(AppliedCommand(replace(self._command, schedule=(pulse,))))

    def _on_report(self, report: CommandReport) -> None:
        """Report a command as a centre does: once its slew is over, for what follows is replaced by the next one."""
        command = self._releases.by_counter[report.counter]
        if command.state not in UNREPORTED:
            return
        until_us = report.executed_until_us
        if report.state in _NOTHING_EXECUTED or (report.state == "executed" and until_us is None):
            self._report(events.Report(self._at(), command.counter, CommandTransition.FAILED))
        elif until_us is not None and (report.state == "executed" or until_us >= self._slew_stop_us(command)):
            is_cut = report.state == "executed" and until_us < command.stop_us
            part_us = until_us if is_cut else None
            executed = events.Report(self._at(), command.counter, CommandTransition.EXECUTED, executed_until_us=part_us)
            self._report(executed)

    def _slew_stop_us(self, command: Command) -> int:
        """Return when the last pulse of a command's slew ends."""
        slew_s = self.torque.slew_share * self._release.spacecraft.control.command_period_s
        begun_us = command.start_us + microseconds(slew_s)
        return max(pulse.stop_us for pulse in command.schedule if pulse.start_us <= begun_us)

    def _report(self, event: events.Report) -> None:
        self._release.handle(event)
        judge_report(self._release, event)

    def _give_up(self, at: Instant) -> None:
        """Report commands whose report is overdue as failed: nothing of them was executed."""
        for command in self._release.state.commands:
            if command.state in UNREPORTED and at.now_us >= command.stop_us + microseconds(_REPORT_TIMEOUT_S):
                self._report(events.Report(at, command.counter, CommandTransition.FAILED))

    def _on_duty(self, at: Instant) -> None:
        """Do what the two persons on duty do."""
        if release_refusal(self._release.spacecraft) is not None:
            return
        handle, interlock = self._release.handle, self._release.state.interlock
        self.trips = tuple(dict.fromkeys((*self.trips, *(condition.word for condition in interlock.trips))))
        if interlock.state is State.TRIPPED and _OWN_TRIPS.issuperset(interlock.trips):
            handle(events.Order(at, _OPERATOR, events.OrderKind.RESET))
        elif interlock.state is State.INHIBITED and not interlock.is_armed:
            handle(events.Order(at, _OPERATOR, events.OrderKind.ARM))
        elif interlock.state is State.RECOVERY:
            self._lead_back(at)
        interlock = self._release.state.interlock
        if interlock.state is State.ARMED:
            until_us = at.now_us + microseconds(self.settings.longest_authorisation_s)
            for by in (_OPERATOR, _APPROVER):
                handle(events.Engage(at, by, until_us, self.settings.envelope, is_approver=by == _APPROVER))

    def _lead_back(self, at: Instant) -> None:
        """Release a single command by two persons, once a command period."""
        release = self._release
        newest_us = max((each.released_us or 0 for each in release.state.commands), default=0)
        period_us = microseconds(release.spacecraft.control.command_period_s)
        is_busy = any(each.state in OPEN or each.state in UNREPORTED for each in release.state.commands)
        if is_busy or at.now_us - newest_us < period_us:
            return
        command = requested(release, CommandRequest("back to the range of automatic control"), at)
        if release.handle(events.Prepare(at, _OPERATOR, command)).refusal is None:
            prepared = release.state.commands[-1]
            release.handle(events.Confirm(at, _APPROVER, prepared.counter, prepared.digest, is_approver=True))
