"""Warnings of a spool: code, text and start; logged once at the beginning and once at the end."""

import logging
from typing import NamedTuple

from service.records.epoch import format_epoch

logger = logging.getLogger("service.frontend.spool.spool")

FULL = "spool.full"
AGED = "spool.aged"
DISK_FULL = "spool.disk_full"
UNWRITABLE = "spool.unwritable"
CORRUPT = "spool.corrupt"


class SpoolWarning(NamedTuple):
    """One thing that is not as it should be."""

    #: spool.full, spool.aged, spool.disk_full, spool.unwritable or spool.corrupt
    code: str
    detail: str
    #: microseconds UTC
    since_us: int

    def as_json(self) -> dict[str, str]:
        """Return the warning as reports tell it."""
        return {"code": self.code, "detail": self.detail, "since": format_epoch(self.since_us)}


class WarningBoard:
    """Warnings that stand."""

    def __init__(self) -> None:
        self._standing: dict[str, SpoolWarning] = {}

    def standing(self) -> list[SpoolWarning]:
        """Return the warnings, oldest first."""
        return sorted(self._standing.values(), key=lambda each: each.since_us)

    def put_up(self, code: str, detail: str, now_us: int) -> None:
        """Warn, or update the text of an active warning."""
        before = self._standing.get(code)
        if before is None:
            logger.error("spool warning %s: %s", code, detail)
        self._standing[code] = SpoolWarning(code, detail, now_us if before is None else before.since_us)

    def withdraw(self, *codes: str) -> None:
        """End warnings."""
        for code in codes:
            if self._standing.pop(code, None) is not None:
                logger.info("spool warning %s has ended", code)
