"""Which driver speaks to which analyzer: asked of ``*IDN?``, before which no connection is believed."""

from collections.abc import Callable

from service.frontend.drivers.base import Dialect
from service.frontend.drivers.generic import GENERIC
from service.frontend.drivers.rs import RS
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.scpi import AnswerError, Identity, parse_identity
from service.frontend.visa_session import AnalyzerIOError, VisaSession

#: in the order in which they are tried; the last fits all
DIALECTS: tuple[Dialect, ...] = (RS, GENERIC)


def dialect_of(identity: Identity, named: str = "auto") -> Dialect:
    """Return the dialect that fits the vendor, or the one that the task names.

    Examples
    --------
    >>> dialect_of(Identity("Rohde&Schwarz", "FSW-26", "1", "5.30")).name
    'rs'
    """
    for dialect in DIALECTS:
        if named == dialect.name or (named == "auto" and dialect.vendor in identity.vendor.lower()):
            return dialect
    message = f"there is no dialect {named!r}"
    raise ValueError(message)


def identify(session: VisaSession) -> Identity:
    """Return what the analyzer says it is.

    Raises
    ------
    AnalyzerIOError
        It says nothing, or something else.
    """
    try:
        return parse_identity(session.query("*IDN?"))
    except AnswerError as error:
        raise AnalyzerIOError(f"{session.resource}: {error}") from error


def make_driver(
    session: VisaSession,
    identity: Identity,
    dialect: Dialect,
    now_us: Callable[[], int],
    *,
    use_analyzer_clock: bool,
    io_timeout_s: float,
    hold_s: float = 0.0,
) -> ScpiDriver:
    """Return the driver of an analyzer that was identified."""
    return ScpiDriver(
        session,
        identity,
        dialect,
        now_us,
        use_analyzer_clock=use_analyzer_clock,
        io_timeout_s=io_timeout_s,
        hold_s=hold_s,
    )
