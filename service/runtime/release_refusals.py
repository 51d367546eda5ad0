"""Refusals of the interlock as errors: each code of the release with the kind of error that tells it."""

from service.errors import ConflictError, ForbiddenError, GoneError, InvalidInputError, NotFoundError, SooError
from service.pipeline.release_interlock.release_events import Refusal

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
    """Return the error that tells a refusal.

    Examples
    --------
    >>> error_of(Refusal("command.expired", "prepare anew"))
    GoneError('command.expired: prepare anew')
    """
    return _KINDS.get(refusal.code, ConflictError)(refusal.code, refusal.detail)
