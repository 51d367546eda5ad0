"""Release of torques: commands from preparation to report, and the interlock."""

from collections.abc import Mapping
from typing import Any, Literal

from service.client.call import Call, Epoch, epoch_text, epochs, window
from service.client.documents import CommandReply, Control, Json
from service.client.endpoint_methods import Series, endpoint, series
from service.client.endpoints.paths import PAGE_ROWS, below


class ReleaseEndpoints:
    """Methods of commands and control."""

    @endpoint
    def prepare_torques(
        self,
        spacecraft_id: str,
        reason: str,
        *,
        attitude_epoch: Epoch | None = None,
        start: Epoch | None = None,
        duration_s: float | None = None,
        max_torque_n_m: float | None = None,
        dry_run: bool = False,
    ) -> Call[CommandReply]:
        """Return a command that waits for another person to confirm its digest.

        Never sent twice: a second request would be another command.

        Parameters
        ----------
        spacecraft_id, reason : str
            Spacecraft, and why.
        attitude_epoch, start : str or int, optional
            Estimate that was looked at, default the newest; begin of the schedule, default as soon as can be.
        duration_s, max_torque_n_m : float, optional
            Default the forecast horizon of the spacecraft, and the limits of spacecraft and wheels.
        dry_run : bool
            Only look: nothing is stored, and failing checks are reported instead of refused.
        """
        body = {"reason": reason, "dry_run": dry_run, "duration_s": duration_s, "max_torque_n_m": max_torque_n_m}
        return Call(
            "POST",
            below(spacecraft_id, "/torques:prepare"),
            body | epochs(attitude_epoch=attitude_epoch, start=start),
        )

    @endpoint
    def command(self, spacecraft_id: str, command_id: int) -> Call[CommandReply]:
        """Return one command as it stands."""
        return Call("GET", below(spacecraft_id, f"/torques/{command_id}"))

    @series
    def commands(
        self, spacecraft_id: str, start: Epoch | None = None, stop: Epoch | None = None, *, limit: int = PAGE_ROWS
    ) -> Series[CommandReply]:
        """Yield every command that was prepared in an interval; parameters as for `attitude_history`."""
        return Series(below(spacecraft_id, "/torques/commands"), window(start, stop, limit))

    @endpoint
    def confirm_torques(
        self, spacecraft_id: str, command_id: int, digest: str, comment: str = ""
    ) -> Call[CommandReply]:
        """Return a command that another person prepared, released.

        Never sent twice: a second request would be refused though the first released the command.
        """
        path = below(spacecraft_id, f"/torques/{command_id}:confirm")
        return Call("POST", path, {"digest": digest, "comment": comment})

    @endpoint
    def cancel_torques(self, spacecraft_id: str, command_id: int, comment: str = "") -> Call[CommandReply]:
        """Take a prepared command back."""
        return Call("POST", below(spacecraft_id, f"/torques/{command_id}:cancel"), {"comment": comment})

    @endpoint
    def report_torques(
        self,
        spacecraft_id: str,
        command_id: int,
        turn: Literal["sent", "executed", "failed"],
        *,
        at: Epoch | None = None,
        executed_from: Epoch | None = None,
        executed_until: Epoch | None = None,
    ) -> Call[CommandReply]:
        """Report what became of a released command; repeating a report is safe.

        Parameters
        ----------
        spacecraft_id, command_id : str and int
            Which command.
        turn : str
            ``sent``, ``executed`` or ``failed``.
        at : str or int, optional
            When; default now.
        executed_from, executed_until : str or int, optional
            Part that was carried out; default all of it (executed) or nothing (failed).
        """
        body = epochs(at=at, executed_from=executed_from, executed_until=executed_until)
        return Call("POST", below(spacecraft_id, f"/torques/{command_id}:{turn}"), body, is_keyed=True)

    @endpoint
    def uplink(self, spacecraft_id: str, command_id: int) -> Call[Json]:
        """Return what goes up of a released command."""
        return Call("GET", below(spacecraft_id, f"/torques/{command_id}/uplink"))

    @endpoint
    def attitude_uplink(self, spacecraft_id: str) -> Call[Json]:
        """Return the newest angles for a spacecraft in mode onboard."""
        return Call("GET", below(spacecraft_id, "/attitude/uplink"))

    @endpoint
    def control(self, spacecraft_id: str) -> Call[Control]:
        """Return what the interlock says, and why."""
        return Call("GET", below(spacecraft_id, "/control"))

    @endpoint
    def order_control(
        self, spacecraft_id: str, order: Literal["arm", "disengage", "reset", "stop"], comment: str = ""
    ) -> Call[Control]:
        """Give the interlock an order; a comment goes to the shift log."""
        return _order(spacecraft_id, order, comment)

    @endpoint
    def engage_control(
        self, spacecraft_id: str, until: Epoch, envelope: Mapping[str, float] | None = None, comment: str = ""
    ) -> Call[Control]:
        """Ask for standing authorisation, or join another person who asked for the same."""
        return _order(spacecraft_id, "engage", comment, until=epoch_text(until), envelope=envelope)

    @endpoint
    def check_sign(self, spacecraft_id: str, axis: str | None = None, comment: str = "") -> Call[Control]:
        """Begin to prove the sign of an axis; default the first that is not proven."""
        return _order(spacecraft_id, "sign-check", comment, axis=axis)


def _order(spacecraft_id: str, order: str, comment: str, **others: Any) -> Call[Control]:
    """Return an order to the interlock; its name stands behind the colon of the path."""
    return Call("POST", below(spacecraft_id, f"/control:{order}"), {**others, "comment": comment})
