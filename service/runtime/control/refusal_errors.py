"""Refusals of the interlock as errors: each code of the release with its kind of error."""

from service.errors import ConflictError, ForbiddenError, GoneError, InvalidInputError, NotFoundError, SooError
from service.pipeline.control.release.events import Refusal
from service.records.catalogue import ControlMode, Release, Spacecraft

#: every other code is a conflict
_KINDS: dict[str, type[SooError]] = {
    "command.unknown": NotFoundError,
    "command.second_person": ForbiddenError,
    "interlock.second_person": ForbiddenError,
    "command.expired": GoneError,
    "interlock.authorisation": InvalidInputError,
    "envelope.wider": InvalidInputError,
    "report.interval": InvalidInputError,
}


def error_of(refusal: Refusal) -> SooError:
    """Return the error of a refusal.

    Examples
    --------
    >>> error_of(Refusal("command.expired", "prepare it again"))
    GoneError('command.expired: prepare it again')
    """
    return _KINDS.get(refusal.code, ConflictError)(refusal.code, refusal.detail)


def release_refusal(spacecraft: Spacecraft) -> Refusal | None:
    """Return why no command of a spacecraft is released one by one, None where they are."""
    control, onboard = spacecraft.control, spacecraft.onboard
    if control.mode is not ControlMode.GROUND:
        return Refusal("control.mode", f"{spacecraft.id} takes no torques: its mode is {control.mode.value}")
    if not (onboard.fast_loop and onboard.forecast_mode):
        return Refusal("control.mode", f"{spacecraft.id} states no fast loop or no Forecast mode on board")
    if control.release is Release.AUTOMATIC:
        detail = "computed commands of this spacecraft count as applied; nothing is prepared or authorised"
        return Refusal("release.automatic", detail)
    return None
