"""Release desk: persons order, rows inform, the interlock decides; what it decides is stored, then told.

Every method may be called from any thread and raises nothing but errors of `service.errors`, with the codes of
docs/reference/errors.md, section Control.
"""

from collections.abc import Sequence

from service.pipeline.release_interlock.release_events import OrderKind
from service.ports import Clock, Outcome, Storage
from service.records.calibration import Window
from service.records.release import (
    CommandView,
    CommandWish,
    ControlView,
    EnvelopeLimits,
    UplinkProduct,
)


class ReleaseDesk:
    """Interlock and commands of all spacecraft.

    Parameters
    ----------
    storage : Storage
        Where state, commands and uplink products are kept.
    clock : Clock
        The only source of time.
    """

    def __init__(self, storage: Storage, clock: Clock) -> None:
        self._storage = storage
        self._clock = clock

    def control(self, spacecraft_id: str) -> ControlView:
        """Return what the interlock says; NotFoundError ``spacecraft.unknown``."""
        raise NotImplementedError

    def order(self, spacecraft_id: str, kind: OrderKind, by: str) -> ControlView:
        """Arm, disengage, reset or stop.

        ConflictError ``interlock.inhibited``, ``interlock.tripped``, ``interlock.trip_stands``,
        ``interlock.not_armed``, ``interlock.state``, ``interlock.simulated``, ``control.mode``.
        """
        raise NotImplementedError

    def engage(
        self, spacecraft_id: str, by: str, *, is_approver: bool, until_us: int, envelope: EnvelopeLimits | None = None
    ) -> ControlView:
        """Ask for standing authorisation, or join who asked for the same; without an envelope that of the settings.

        Beside those of `order`: ConflictError ``interlock.sign_unproven``, ``release.automatic``; ForbiddenError
        ``interlock.second_person``; InvalidInputError ``interlock.authorisation``, ``envelope.wider``.
        """
        raise NotImplementedError

    def prepare(self, spacecraft_id: str, by: str, wish: CommandWish, *, dry_run: bool = False) -> CommandView:
        """Return a prepared command; a dry run stores nothing and tells failing checks instead of refusing.

        ConflictError ``interlock.inhibited``, ``interlock.tripped``, ``interlock.not_armed``,
        ``interlock.simulated``, ``interlock.yaw_withheld``, ``control.mode``, ``release.automatic``,
        ``envelope.exceeded``, ``schedule.rejected``, ``command.open``, ``command.unreported``, ``command.empty``,
        ``command.estimate_stale``, ``command.no_estimate``, ``command.start_passed``, ``command.too_long``;
        InvalidInputError ``command.wish``.
        """
        raise NotImplementedError

    def confirm(
        self, spacecraft_id: str, counter: int, by: str, digest: str, *, is_approver: bool, comment: str = ""
    ) -> CommandView:
        """Return a command released.

        NotFoundError ``command.unknown``; GoneError ``command.expired``; ForbiddenError ``command.second_person``;
        ConflictError ``command.digest``, ``command.state`` and those of `prepare`.
        """
        raise NotImplementedError

    def cancel(self, spacecraft_id: str, counter: int, by: str) -> CommandView:
        """Take a prepared command back; NotFoundError ``command.unknown``, ConflictError ``command.state``."""
        raise NotImplementedError

    def report(
        self,
        spacecraft_id: str,
        counter: int,
        turn: str,
        *,
        by: str,
        at_us: int | None = None,
        executed_from_us: int | None = None,
        executed_until_us: int | None = None,
    ) -> CommandView:
        """Take what the centre tells of a released command: ``sent``, ``executed`` or ``failed``.

        NotFoundError ``command.unknown``; ConflictError ``command.state``; InvalidInputError ``report.interval``,
        ``report.time``.
        """
        raise NotImplementedError

    def command(self, spacecraft_id: str, counter: int) -> CommandView:
        """Return one command; NotFoundError ``command.unknown``."""
        raise NotImplementedError

    def commands(
        self, spacecraft_id: str, window: Window, limit: int, after: tuple[int, int] | None = None
    ) -> list[CommandView]:
        """Return commands prepared in a window in order of (prepared, counter) beyond a cursor."""
        raise NotImplementedError

    def uplink(self, spacecraft_id: str, counter: int) -> UplinkProduct:
        """Return the product of a released command; NotFoundError ``uplink.unknown``."""
        raise NotImplementedError

    def attitude_uplink(self, spacecraft_id: str) -> UplinkProduct:
        """Return the newest angles for a spacecraft in mode onboard.

        ConflictError ``control.mode``; NotFoundError ``uplink.unknown`` before the first, GoneError ``uplink.expired``.
        """
        raise NotImplementedError

    def sign_check(self, spacecraft_id: str, axis: str, by: str) -> ControlView:
        """Start the sign check of an axis: its legs are prepared one after the other, each to be confirmed.

        ConflictError ``sign_check.running`` and those of `prepare`; InvalidInputError ``sign_check.axis``.
        """
        raise NotImplementedError

    def see(self, spacecraft_id: str, outcomes: Sequence[Outcome]) -> None:
        """Take over what was computed, after it was stored; called from the supervisor's thread."""
        raise NotImplementedError

    def tick(self) -> None:
        """Let time pass for every spacecraft."""
        raise NotImplementedError
