"""Tracking messages of carrier powers: text as the standard has it, quality, and what is refused."""

from collections.abc import Iterator

import numpy as np
import pytest

from service.errors import InvalidInputError
from service.formats.tdm import SEGMENT_ROWS, TdmWriter, TrackingMessage, read_tdm
from service.records.catalogue import Carrier
from service.records.epoch import US_PER_S, parse_epoch
from service.records.levels.measurement import Measurement
from service.records.levels.quality_flag import QualityFlag

START_US = parse_epoch("2026-11-21T00:00:00Z")
MESSAGE = TrackingMessage("YAMAL-202", "Moscow", "m-2", START_US)
CARRIERS = [Carrier(f"c{k}", "Ku", "Ku1", 11.0e9 + 1e6 * k, 1.25e6) for k in range(2)]


def _row(k: int, powers: list[float], flags: list[int] | None = None, source: str = "sa-1") -> Measurement:
    epoch_us = START_US + 60 * US_PER_S * k
    stored = np.array(powers, dtype=np.float32).astype(np.float64)
    return Measurement(
        epoch_us, epoch_us, k + 1, source, 1, stored, None if flags is None else np.array(flags, dtype=np.int64)
    )


def _written(rows: list[Measurement]) -> str:
    writer = TdmWriter(MESSAGE, lambda _plan: CARRIERS)
    return (writer.header() + b"".join(writer.segments([rows]))).decode("ascii")


def test_message_of_one_carrier_line_by_line() -> None:
    assert _written([_row(0, [-42.1, np.nan]), _row(1, [-42.25, np.nan])]).splitlines() == [
        "CCSDS_TDM_VERS = 2.0",
        "CREATION_DATE = 2026-11-21T00:00:00.000000",
        "ORIGINATOR = SOO",
        "MESSAGE_ID = m-2",
        "META_START",
        "COMMENT carrier=c0 name=c0 transponder=Ku1",
        "COMMENT downlink_hz=11000000000 bandwidth_hz=1250000",
        "COMMENT time tags are the middle of the dwell",
        "TRACK_ID = sa-1/c0",
        "DATA_TYPES = CARRIER_POWER",
        "TIME_SYSTEM = UTC",
        "START_TIME = 2026-11-21T00:00:00.000000",
        "STOP_TIME = 2026-11-21T00:01:00.000000",
        "PARTICIPANT_1 = YAMAL-202",
        "PARTICIPANT_2 = Moscow",
        "MODE = SEQUENTIAL",
        "PATH = 1,2",
        "RECEIVE_BAND = KU",
        "TIMETAG_REF = RECEIVE",
        "DATA_QUALITY = RAW",
        "META_STOP",
        "DATA_START",
        "CARRIER_POWER = 2026-11-21T00:00:00.000000 -72.1",
        "CARRIER_POWER = 2026-11-21T00:01:00.000000 -72.25",
        "DATA_STOP",
    ]


def test_powers_come_back_bit_for_bit() -> None:
    rng = np.random.default_rng(8)
    levels = rng.uniform(-120.0, 10.0, (40, 2)).round(5)
    rows = [_row(k, [*level]) for k, level in enumerate(levels.tolist())]
    tracks = read_tdm(_written(rows))
    assert [track.track_id for track in tracks] == ["sa-1/c0", "sa-1/c1"]
    for position, track in enumerate(tracks):
        assert track.epochs_us.tolist() == [row.epoch_us for row in rows]
        stored = np.array([row.power_dbm[position] for row in rows], dtype=np.float32)
        assert track.power_dbm.astype(np.float32).tobytes() == stored.tobytes()


def test_doubtful_rows_stand_apart() -> None:
    overrange = int(QualityFlag.OVERRANGE)
    simulated = int(QualityFlag.SIMULATED)
    rows = [_row(0, [-40, -50], [0, simulated]), _row(1, [-41, -51], [overrange, 0]), _row(2, [-42, np.nan], [0, 16])]
    reported = [(track.track_id, track.quality, track.power_dbm.tolist()) for track in read_tdm(_written(rows))]
    assert reported == [
        ("sa-1/c0", "VALIDATED", [-40.0, -42.0]),
        ("sa-1/c0", "DEGRADED", [-41.0]),
        ("sa-1/c1", "VALIDATED", [-50.0, -51.0]),
    ]


def test_two_sources_never_share_a_segment() -> None:
    rows = [_row(0, [-40, -50]), _row(0, [-40.5, -50.5], source="sa-2")]
    assert [track.track_id for track in read_tdm(_written(rows))] == ["sa-1/c0", "sa-1/c1", "sa-2/c0", "sa-2/c1"]


def test_memory_is_that_of_one_stretch() -> None:
    row = _row(0, [-40.0, -50.0])
    taken = 0

    def pages() -> Iterator[list[Measurement]]:
        nonlocal taken
        for _ in range(30):
            taken += 1
            yield [row] * 1000

    next(TdmWriter(MESSAGE, lambda _plan: CARRIERS).segments(pages()))
    assert taken == SEGMENT_ROWS // 1000


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("CARRIER_POWER = 2026", "CARRIER_POWER 2026"),
        ("-72.1", "minus"),
        ("-72.1", "nan"),
        ("T00:00:00.000000 -72.1", "T25:00:00.000000 -72.1"),
        ("CCSDS_TDM_VERS", "CCSDS_AEM_VERS"),
    ],
)
def test_malformed_lines_are_named(old: str, new: str) -> None:
    text = _written([_row(0, [-42.1, -50.0])])
    with pytest.raises(InvalidInputError) as refusal:
        read_tdm(text.replace(old, new, 1))
    assert refusal.value.code == "ccsds.malformed"
