"""Reports on intervals of the archive: manifests of exports, gaps, samples."""

from typing import Literal, Self

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.api.schemas.record_answers import members_of
from service.core.rows.sample_bins import Samples
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


class SampleAnswer(Answer):
    """One interval that holds a value."""

    epoch: EpochAnswer
    """Begin of the interval."""
    n: int
    avg: float
    min: float
    max: float
    min_epoch: EpochAnswer
    """First row that holds the least value."""
    max_epoch: EpochAnswer

    @classmethod
    def all_of(cls, samples: Samples) -> list[Self]:
        """Return the answers for the intervals of a column."""
        columns = (
            samples.starts_us,
            samples.counts,
            samples.means,
            samples.minima,
            samples.maxima,
            samples.minimum_epochs_us,
            samples.maximum_epochs_us,
        )
        names = tuple(cls.model_fields)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return [cls.model_validate(dict(zip(names, row, strict=True))) for row in rows]


class AttitudeSamples(Answer):
    """Attitude in intervals of equal length; intervals without a value are left out."""

    range: WindowAnswer
    method: Method
    version: str
    yaw_deg: list[SampleAnswer]
    roll_deg: list[SampleAnswer]
    pitch_deg: list[SampleAnswer]


class MeasurementSamples(Answer):
    """Levels in intervals of equal length by carrier id; intervals without a level are left out."""

    range: WindowAnswer
    source: str | None
    """Null = rows of every source."""
    power_dbm: dict[str, list[SampleAnswer]]


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
