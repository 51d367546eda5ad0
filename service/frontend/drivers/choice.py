"""Choice of the driver of an analyzer by its answer to ``*IDN?``, which also proves the connection."""

import re

from service.frontend.drivers.anritsu import ANRITSU
from service.frontend.drivers.base import Dialect
from service.frontend.drivers.generic import GENERIC
from service.frontend.drivers.keysight import KEYSIGHT
from service.frontend.drivers.rs import RS
from service.frontend.drivers.scpi import AnswerError, Identity, parse_identity
from service.frontend.drivers.siglent import SIGLENT
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession

#: in the order in which they are tried; the last fits all
DIALECTS: tuple[Dialect, ...] = (RS, KEYSIGHT, ANRITSU, SIGLENT, GENERIC)


def dialect_of(identity: Identity, named: str = "auto") -> Dialect:
    """Return the dialect that fits the identity, or the one that the task names.

    Examples
    --------
    >>> dialect_of(Identity("Rohde&Schwarz", "FSW-26", "1", "5.30")).name
    'rs'
    >>> dialect_of(Identity("Agilent Technologies", "N9010A", "MY1", "A.14")).name
    'keysight'
    """
    who = f"{identity.vendor},{identity.model}"
    for dialect in DIALECTS:
        if named == dialect.name or (named == "auto" and re.search(dialect.identity, who, re.IGNORECASE)):
            return dialect
    message = f"there is no dialect {named!r}"
    raise ValueError(message)


def identify(session: VisaSession) -> Identity:
    """Return the identity that the analyzer states.

    Raises
    ------
    AnalyzerIOError
        It says nothing, or something else.
    """
    try:
        return parse_identity(session.query("*IDN?"))
    except AnswerError as error:
        raise AnalyzerIOError(f"{session.resource}: {error}") from error
