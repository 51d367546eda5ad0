"""Reports on intervals of the archive: manifests of exports, gaps."""

from typing import Literal

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.api.schemas.record_answers import members_of
from service.records.catalogue import Method
from service.records.levels.series import SourceState


class PartAnswer(Answer):
    """One UTC day of an export, a file of its own."""

    start: EpochAnswer
    stop: EpochAnswer
    rows: int
    """Rows of the archive; messages of CCSDS leave out those without a value."""
    bytes: int
    sha256: str
    closed: bool
    """True: the day is over; only late rows change the file of a closed day."""
    href: str
    """Where the file is, relative to the service; takes Range and If-Range."""


class ManifestAnswer(Answer):
    """Files of an export day by day, days without rows left out."""

    range: WindowAnswer
    series: str
    format: Literal["csv", "ndjson", "parquet", "aem", "tdm"]
    method: Method | None
    """Of attitude."""
    version: str | None
    """Of attitude and torques."""
    parts: list[PartAnswer]
    next: str | None


class GapAnswer(Answer):
    """Instants without a row: start inclusive, stop exclusive."""

    start: EpochAnswer
    stop: EpochAnswer
    rows_missing: int
    """By the usual distance of rows."""


class SourceRowsAnswer(members_of(SourceState, without=("newest_epoch_us",)), Answer):
    """Rows and missing rows of a source over all time."""


class GapsAnswer(Answer):
    """Gaps in the rows of a source, or in those that feed the estimator."""

    range: WindowAnswer
    source: str | None
    """Null = rows that fed the estimator, whichever source they came from."""
    gaps: list[GapAnswer]
    sources: list[SourceRowsAnswer]
