"""Kinds of faults: those that pass when the transaction runs again, and those that say that a wait has ended in vain.

PostgreSQL tells them by the codes of its manual, appendix A, SQLite by a result code that the driver passes on.
"""

from sqlalchemy.exc import DBAPIError

#: serialization_failure, deadlock_detected: one of two transactions was ended, the other went on
_PASSING = frozenset({"40001", "40P01"})
#: lock_not_available, query_canceled, idle_in_transaction_session_timeout
_WAIT_ENDED = frozenset({"55P03", "57014", "25P03"})
_BUSY = "SQLITE_BUSY"


def is_passing(fault: BaseException) -> bool:
    """Return whether a transaction was ended so that another could go on: it may run again at once."""
    return _state_of(fault) in _PASSING


def is_wait_ended(fault: BaseException) -> bool:
    """Return whether a lock, or an answer of the server, was waited for too long."""
    if not isinstance(fault, DBAPIError):
        return False
    is_busy = getattr(fault.orig, "sqlite_errorname", "").startswith(_BUSY)
    return is_busy or getattr(fault.orig, "is_wait_ended", False) or _state_of(fault) in _WAIT_ENDED


def _state_of(fault: BaseException) -> str | None:
    """Return the code that PostgreSQL gives a fault."""
    found = getattr(fault.orig, "sqlstate", None) if isinstance(fault, DBAPIError) else None
    return None if found is None else str(found)
