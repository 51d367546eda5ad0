"""Tracking Data Messages (CCSDS 503.0-B-2, TDM 2.0, keyword = value) of carrier powers: written page by page, and read.

One segment a carrier and stretch of rows, for a keyword may have one value an epoch in a segment (3.4.11).
``CARRIER_POWER`` is in dBW (= dBm - 30) at the station's reference point; ``PC_N0`` in dB-Hz where the front end sent
it. The instrument's and the path's calibration is in the values; rain and atmosphere are not taken off (3.4.15).
``DATA_QUALITY`` holds for a whole segment: rows whose flags doubt the level stand in segments of their own, DEGRADED;
the others are VALIDATED by the front end's checks, or RAW where the source sent no flags. Absent levels are left out.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from service.errors import InvalidInputError
from service.formats import ccsds
from service.formats.ephemeris import utc_us
from service.formats.numbers import text_of_float32
from service.records.catalogue import Carrier
from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.measurement import Measurement, QualityFlag

#: dBW = dBm - 30
DBM_OF_DBW = 30.0
#: rows of one segment at most: what is held in memory, times the carriers
SEGMENT_ROWS = 20_000
#: flags that doubt the level itself
DEGRADING = int(
    QualityFlag.CLOCK_UNSYNC
    | QualityFlag.OVERRANGE
    | QualityFlag.UNCAL
    | QualityFlag.INTERFERENCE
    | QualityFlag.EXPIRED
    | QualityFlag.SETTING_MISMATCH
    | QualityFlag.STALE_TRACE
    | QualityFlag.NONFINITE_VALUE
    | QualityFlag.NEIGHBOUR
    | QualityFlag.NOISE_WINDOW_DIRTY
    | QualityFlag.LOW_C_N
    | QualityFlag.FREQUENCY_OFFSET
    | QualityFlag.REFERENCE_UNLOCKED
)
#: decimals of a power: a float32 of one hundredth of a decibel and more is named by them
_DECIMALS = 9
_VERSION = "CCSDS_TDM_VERS"


@dataclass(frozen=True, slots=True)
class TrackingMessage:
    """Header and segment metadata of a tracking message."""

    #: transmitter: the spacecraft
    spacecraft: str
    #: receiver: the station of the analyzer
    receiving_site: str
    message_id: str
    created_at_us: int
    originator: str = "SOO"


@dataclass(frozen=True, slots=True)
class _Block:
    """Rows of one source and one plan."""

    source: str
    carriers: tuple[Carrier, ...]
    epochs_us: IntArray
    #: (T, N)
    power_dbm: FloatArray
    #: (T, N) masks, or None where the source sent none
    flags: IntArray | None
    #: (T, N) dB-Hz, NaN = not stated
    c_n0_db_hz: FloatArray


class TdmWriter:
    """Writer of one message.

    Parameters
    ----------
    message : TrackingMessage
        Header and participants.
    carriers_of : callable
        Gives the carriers of a plan by its number.
    """

    def __init__(self, message: TrackingMessage, carriers_of: Callable[[int], Sequence[Carrier]]) -> None:
        self._message = message
        self._carriers_of = carriers_of

    def header(self) -> bytes:
        """Return what stands before the first segment."""
        message = self._message
        return ccsds.message_header(_VERSION, message.created_at_us, message.originator, message.message_id)

    def segments(self, pages: Iterable[Sequence[Measurement]]) -> Iterator[bytes]:
        """Yield the segments of rows that come in order of epoch, one stretch of rows held at a time."""
        for block in self._blocks(pages):
            for position in range(len(block.carriers)):
                yield from self._segments_of(block, position)

    def _blocks(self, pages: Iterable[Sequence[Measurement]]) -> Iterator[_Block]:
        """Gather rows of one source, plan and presence of flags."""
        for rows in _stretches(pages):
            ordered = sorted(rows, key=_kind)
            for (source, plan_id, has_flags), group in groupby(ordered, key=_kind):
                members = list(group)
                yield _Block(
                    source,
                    tuple(self._carriers_of(plan_id)),
                    np.array([row.epoch_us for row in members], dtype=np.int64),
                    np.array([row.power_dbm for row in members]),
                    np.array([row.flags for row in members], dtype=np.int64) if has_flags else None,
                    np.array([_c_n0_of(row) for row in members]),
                )

    def _segments_of(self, block: _Block, position: int) -> Iterator[bytes]:
        """Yield the segments of one carrier: good rows, then doubtful ones."""
        is_present = np.isfinite(block.power_dbm[:, position])
        if block.flags is None:
            parts = [("RAW", is_present)]
        else:
            is_doubtful = (block.flags[:, position] & DEGRADING) != 0
            parts = [("VALIDATED", is_present & ~is_doubtful), ("DEGRADED", is_present & is_doubtful)]
        for quality, rows in parts:
            if rows.any():
                yield self._segment(block, position, quality, np.flatnonzero(rows))

    def _segment(self, block: _Block, position: int, quality: str, rows: IntArray) -> bytes:
        epochs = ccsds.epoch_texts(block.epochs_us[rows])
        # the stored float32 in dBm has few digits; 30 dB less are taken from its shortest decimal, not from its bits
        powers = [float(text) - DBM_OF_DBW for text in text_of_float32(block.power_dbm[rows, position])]
        densities = text_of_float32(block.c_n0_db_hz[rows, position])
        data = []
        for epoch, power, density in zip(epochs, powers, densities, strict=True):
            data.append(f"CARRIER_POWER = {epoch} {_decimal(power)}")
            if density:
                data.append(f"PC_N0 = {epoch} {density}")
        types = "CARRIER_POWER,PC_N0" if any(densities) else "CARRIER_POWER"
        meta = self._meta(block, position, quality, (epochs[0], epochs[-1]), types)
        return ccsds.as_bytes([*meta, "DATA_START", *data, "DATA_STOP"])

    def _meta(self, block: _Block, position: int, quality: str, span: tuple[str, str], types: str) -> list[str]:
        carrier = block.carriers[position]
        return [
            "META_START",
            ccsds.comment(f"carrier={carrier.id} name={carrier.name or carrier.id} transponder={carrier.transponder}"),
            ccsds.comment(f"downlink_hz={carrier.downlink_hz:.0f} bandwidth_hz={carrier.bandwidth_hz:.0f}"),
            ccsds.comment("time tags are the middle of the dwell"),
            ccsds.line("TRACK_ID", f"{block.source}/{carrier.id}"),
            f"DATA_TYPES = {types}",
            "TIME_SYSTEM = UTC",
            f"START_TIME = {span[0]}",
            f"STOP_TIME = {span[1]}",
            ccsds.line("PARTICIPANT_1", self._message.spacecraft),
            ccsds.line("PARTICIPANT_2", self._message.receiving_site),
            "MODE = SEQUENTIAL",
            "PATH = 1,2",
            ccsds.line("RECEIVE_BAND", carrier.band.upper()),
            "TIMETAG_REF = RECEIVE",
            f"DATA_QUALITY = {quality}",
            "META_STOP",
        ]


def _decimal(value: float) -> str:
    """Return a value without the zeros that say nothing."""
    return f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")


def _c_n0_of(row: Measurement) -> FloatArray:
    """Return what a row states of carrier over noise density, NaN where it states nothing."""
    return np.full(len(row.power_dbm), np.nan) if row.details is None else np.asarray(row.details.c_n0_db_hz)


def _kind(row: Measurement) -> tuple[str, int, bool]:
    return row.source, row.plan_id, row.flags is not None


def _stretches(pages: Iterable[Sequence[Measurement]]) -> Iterator[list[Measurement]]:
    """Yield rows in lists of at most SEGMENT_ROWS."""
    held: list[Measurement] = []
    for page in pages:
        held += page
        while len(held) >= SEGMENT_ROWS:
            yield held[:SEGMENT_ROWS]
            held = held[SEGMENT_ROWS:]
    if held:
        yield held


@dataclass(frozen=True, slots=True)
class PowerTrack:
    """Powers of one segment as read."""

    #: source and carrier as TRACK_ID has them; empty where there is none
    track_id: str
    quality: str
    epochs_us: IntArray
    power_dbm: FloatArray
    #: dB-Hz at the same epochs, NaN where the message has none
    c_n0_db_hz: FloatArray


def read_tdm(text: str) -> tuple[PowerTrack, ...]:
    """Return carrier powers, and what stands beside them of PC_N0; other data types are passed over.

    Raises
    ------
    InvalidInputError
        ``ccsds.malformed`` with the line, ``ccsds.unsupported`` with the keyword.
    """
    tracks = []
    for segment in ccsds.read_segments(text, _VERSION):
        meta = segment.meta
        if meta.get("CORRECTIONS_APPLIED", "YES").upper() == "NO":
            stated = ", ".join(f"{name} = {value}" for name, value in meta.items() if name.startswith("CORRECTION_"))
            detail = f"CORRECTIONS_APPLIED = NO ({stated or 'no correction is named'}): apply them and export again"
            raise InvalidInputError("ccsds.unsupported", detail)
        powers: dict[int, float] = {}
        densities: dict[int, float] = {}
        for number, content in segment.data:
            keyword, value = ccsds.keyword_and_value(number, content)
            if keyword == "CARRIER_POWER":
                epoch_us, power_dbw = _observation(number, value)
                power_dbm = round(power_dbw + DBM_OF_DBW, _DECIMALS)
                if powers.setdefault(epoch_us, power_dbm) != power_dbm:
                    first = powers[epoch_us] - DBM_OF_DBW
                    raise ccsds.malformed(
                        number, f"a second power of {value.split()[0]}: {first:g} and {power_dbw:g} dBW"
                    )
            elif keyword == "PC_N0":
                epoch_us, density = _observation(number, value)
                densities[epoch_us] = density
        own_us = np.array(list(powers), dtype=np.int64)
        tracks.append(
            PowerTrack(
                meta.get("TRACK_ID", ""),
                meta.get("DATA_QUALITY", ""),
                utc_us(own_us, meta.get("TIME_SYSTEM", "").upper()),
                np.array(list(powers.values())),
                np.array([densities.get(epoch_us, np.nan) for epoch_us in powers]),
            )
        )
    return tuple(tracks)


def _observation(number: int, value: str) -> tuple[int, float]:
    """Return epoch and value of one line of data."""
    epoch, _, text = value.rpartition(" ")
    try:
        power_dbw = float(text)
    except ValueError as error:
        raise ccsds.malformed(number, "a line of data is KEYWORD = epoch value") from error
    if not np.isfinite(power_dbw):
        raise ccsds.malformed(number, f"{text.strip()} is no power")
    return ccsds.epoch_of(number, epoch), power_dbw
