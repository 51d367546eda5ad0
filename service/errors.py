"""Errors of the service; every one says what happened, to which thing, and what to do next.

The tree, with the HTTP status that service.api gives each::

    SooError
    |- ForbiddenError       403  another person must do this
    |- NotFoundError        404  the named thing does not exist
    |- ConflictError        409  the thing exists already, or its state forbids the step
    |- GoneError            410  the thing was there and its time is over
    |- InvalidInputError    422  the input contradicts itself or the catalogue; carries field errors
    |- BusyError            429  as much is computed or waits already as may be
    |- UnavailableError     503  what computes has ended
    |- StorageError         503  the archive cannot keep what was sent; nothing was acknowledged

A failed epoch is not an error: it is a row with a status and reasons.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FieldError:
    """One fault in one field of an input."""

    #: JSON pointer to the field, for example ``/carriers/3/id``
    pointer: str
    #: stable machine-readable code, for example ``carrier.duplicate``
    code: str
    #: what is wrong and what to do
    detail: str


class SooError(Exception):
    """Root of all errors that a user can meet.

    Parameters
    ----------
    code : str
        Stable machine-readable code, ``thing.fault``.
    detail : str
        What happened, to which thing, what to do next.
    fields : tuple of FieldError
        The faulty fields, when the fault lies in an input.
    """

    def __init__(self, code: str, detail: str, fields: tuple[FieldError, ...] = ()) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail
        self.fields = fields

    def __reduce__(self) -> tuple[type["SooError"], tuple[str, str, tuple[FieldError, ...]]]:
        """Return what a process needs to raise the error of another one."""
        return type(self), (self.code, self.detail, self.fields)


class ForbiddenError(SooError):
    """Another person must do this."""


def source_not_yours(name: str, owner: str | None, station: str) -> ForbiddenError:
    """Return the refusal of what the key of another station sends for a source."""
    detail = f"Source {name!r} belongs to station {owner!r}, the key to station {station!r}."
    return ForbiddenError("source.not_yours", detail)


class NotFoundError(SooError):
    """The named thing does not exist."""


class ConflictError(SooError):
    """The thing exists already, or its state forbids the step."""


class GoneError(SooError):
    """The thing was there and its time is over."""


class InvalidInputError(SooError):
    """The input contradicts itself or the catalogue."""


class BusyError(SooError):
    """As much is computed or waits already as may be; try again later."""


class UnavailableError(SooError):
    """The process that computed has ended; try again."""


class StorageError(SooError):
    """The archive cannot be read or written; try again later."""
