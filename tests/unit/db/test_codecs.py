"""Stored columns, powers, carriers and details come back bit for bit, and take no more bytes than they need."""

import dataclasses
import math
import struct
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hypothesis.extra.numpy import arrays

from db.encoding import segments
from db.encoding.column_codec import PackedColumns, pack_columns
from db.encoding.measurement_runs import details_of, pack_carriers, prepare_details, unpack_carriers
from db.encoding.power_codec import (
    NO_FLAGS,
    _many_rows,
    _one_row,
    canonical_powers,
    pack_flags,
    pack_powers,
    unpack_flags,
    unpack_parts,
    unpack_powers,
)
from db.encoding.record_codec import decode, decode_all, decode_input, encode, encode_all, kind_of
from db.encoding.segments import (
    CODEC,
    Blobs,
    Extras,
    SealedRows,
    SegmentCache,
    SegmentChunk,
    SegmentHead,
    crc32_of,
    pack,
    unpack_columns,
    unpack_extras,
)
from db.encoding.summary_codec import pack_day, unpack_level, unpack_rows
from service.core.estimation.filtering.anchor import HYPOTHESES
from service.core.rows import Summaries
from service.errors import StorageError
from service.records.inputs import KINDS, AttitudeReference, Operation, PlanChange
from service.records.levels.attitude import CARRIER_HYPOTHESES, CARRIER_STATES, STEP_DB, Axes, CarrierResults
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails


@settings(derandomize=True, deadline=None)
@given(st.lists(st.floats()))
def test_floats_survive_as_bits(values):
    stored = decode_all(float, encode_all(float, tuple(values)))
    # repr of a float is exact, tells -0.0 from 0.0 and lets NaN equal NaN
    assert repr(stored) == repr(tuple(values))


def test_a_document_is_plain_json_with_field_names():
    record = AttitudeReference("other", 5, Axes(float("nan"), 1.0, -0.0), Axes(1e-3, float("inf"), 3.0))
    text = encode(record)
    assert text == '{"source":"other","epoch_us":5,"attitude_deg":[NaN,1.0,-0.0],"sigma_deg":[0.001,Infinity,3.0]}'
    assert repr(decode(AttitudeReference, text)) == repr(record)


def test_quotes_and_letters_of_any_script_survive():
    record = Operation(1, "other", 5, None, comment='"Ямал" \\ \u2028 \U0001f6f0')
    assert decode_input("operation", encode(record)) == record


@pytest.mark.parametrize(("kind", "record_type"), KINDS.items())
def test_every_kind_of_input_has_a_name_and_a_key(kind, record_type):
    assert dataclasses.is_dataclass(record_type)
    assert isinstance(record_type.key, property)
    assert kind_of(object.__new__(record_type)) == kind


def test_documents_are_checked_when_read():
    with pytest.raises(StorageError, match=r"storage\.corrupt: A stored PlanChange cannot be read: plan_id: Field"):
        decode(PlanChange, "{}")


LEVELS = st.floats(-131.0, 131.0) | st.just(float("nan"))


@settings(derandomize=True, deadline=None)
@given(data=st.data(), count=st.integers(1, 40))
def test_what_is_stored_comes_back(data, count):
    def column(values):
        return np.array(data.draw(st.lists(values, min_size=count, max_size=count)))

    state, hypothesis = (column(st.integers(0, len(names) - 1)) for names in (CARRIER_STATES, CARRIER_HYPOTHESES))
    stored = CarrierResults(data.draw(st.integers(1, 2**31 - 1)), column(LEVELS), column(LEVELS), state, hypothesis)
    found = unpack_carriers(pack_carriers(stored))
    assert found.plan_id == stored.plan_id
    for name in ("deviation_db", "residual_db"):
        np.testing.assert_allclose(getattr(found, name), getattr(stored, name), rtol=0, atol=0.5001 * STEP_DB)
    np.testing.assert_array_equal(found.state, stored.state)
    np.testing.assert_array_equal(found.hypothesis, stored.hypothesis)
    # stored again it is the same
    assert pack_carriers(found) == pack_carriers(stored)


def test_a_level_beyond_all_is_the_greatest_one():
    nothing = np.zeros(3, dtype=np.int64)
    levels = np.array([1e9, -1e9, np.inf])
    found = unpack_carriers(pack_carriers(CarrierResults(1, levels, levels, nothing, nothing)))
    assert found.deviation_db.tolist() == [131.068, -131.068, 131.068]


def test_hypotheses_are_those_of_the_filter():
    assert (None, *HYPOTHESES) == CARRIER_HYPOTHESES


INT64 = st.integers(-(1 << 63), (1 << 63) - 1)
#: texts as JSON writes numbers, and what only looks so
NUMBERS = st.one_of(
    st.floats().map(repr),
    INT64.map(str),
    st.sampled_from(
        ["-0", "05", "1e5", "1E5", "1.50", "0.1", "-0.0", "9" * 30, "9" * 5000, "1.5.2", "--3", "٣", "1e400"]
    ),
)
TEXTS = st.one_of(
    st.text(max_size=5),
    st.lists(st.one_of(NUMBERS, st.sampled_from(["[", ", ", '{"a": ', "%s", "%", "c"])), max_size=6).map("".join),
)
COLUMN_KINDS = {
    "integer": st.none() | INT64,
    "truth": st.none() | st.booleans(),
    "double": st.floats().map(lambda value: math.nan if math.isnan(value) else value),
    "text": st.none() | TEXTS,
    "string": st.none() | st.binary(max_size=4),
    "narrow": st.binary(min_size=3, max_size=3),
    "absent": st.none(),
}


@st.composite
def tables(draw):
    count = draw(st.integers(1, 12))
    return count, {name: draw(st.lists(kind, min_size=count, max_size=count)) for name, kind in COLUMN_KINDS.items()}


def bits(values):
    """Return values as text that tells every bit; NaN is one object."""
    return [
        (struct.pack("<d", value), value is math.nan) if isinstance(value, float) else (type(value), value)
        for value in values
    ]


@settings(derandomize=True, deadline=None)
@given(table=tables(), data=st.data())
def test_every_bit_comes_back(table, data):
    count, columns = table
    packed = PackedColumns(pack_columns(columns), count)
    start, stop = sorted(data.draw(st.tuples(st.integers(0, count), st.integers(0, count))))
    positions = data.draw(st.lists(st.integers(0, count - 1), max_size=4))
    for name, values in columns.items():
        assert bits(packed.values(name, slice(None))) == bits(values), name
        assert bits(packed.values(name, slice(start, stop))) == bits(values[start:stop]), name
        chosen = np.array(positions, dtype=np.int64)
        assert bits(packed.values(name, chosen)) == bits([values[position] for position in positions]), name


def test_what_repeats_another_column_costs_next_to_nothing():
    random = np.random.default_rng(3)
    figures = random.normal(size=2000).tolist()
    one = pack_columns({"a": figures})
    texts = [f'[{{"torque": {value!r}, "names": ["x"]}}]' for value in figures]
    assert len(pack_columns({"a": figures, "b": figures, "c": texts})) < 1.02 * len(one)
    assert len(one) < 8 * 2000


@pytest.mark.parametrize("count", [2, 4])
def test_another_number_of_rows_is_a_value_error(count):
    with pytest.raises(ValueError, match="bytes where"):
        PackedColumns(pack_columns({"a": [1, 2, 3]}), count)


def test_what_is_no_zstd_is_a_value_error():
    with pytest.raises(ValueError, match=r"decompress|frame"):
        PackedColumns(b"nothing", 3)


NAN = float("nan")


def details(*kinds: int, rows: int = 3, carriers: int = 5) -> CarrierDetails:
    """Return details that state some kinds of figures in every row but the second."""
    figures = np.full((len(DETAIL_NAMES), rows, carriers), NAN, dtype=np.float32)
    for kind in kinds:
        figures[kind] = kind + np.arange(rows * carriers, dtype=np.float32).reshape(rows, carriers) / 7
    figures[:, 1] = NAN
    return CarrierDetails(*figures)


@pytest.mark.parametrize("kinds", [(0,), (3,), (0, 2), (1, 3), (0, 1, 2, 3)])
def test_figures_come_back_and_only_what_is_stated_takes_bytes(kinds):
    sent = details(*kinds)
    prepared = prepare_details(sent)
    assert prepared.width == 1 + 4 * 5 * len(kinds)
    assert prepared.is_stated.tolist() == [True, False, True]
    for row in range(3):
        reported = details_of(prepared.figures[row * prepared.width : (row + 1) * prepared.width], 5)
        for name in DETAIL_NAMES:
            # float32 widened: no tolerance
            np.testing.assert_array_equal(getattr(reported, name), getattr(sent, name)[row].astype(np.float64))


def test_what_states_nothing_is_nothing():
    assert prepare_details(None) is None
    assert prepare_details(details()) is None


SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 40))
#: any bits but infinities, which are refused long before
ANY = arrays("<u4", SHAPES).map(lambda bits: np.where(np.isinf(bits.view("<f4")), np.float32(-0.0), bits.view("<f4")))
POWER_LEVELS = np.linspace(-70, -50, 32)


def rows_of(stored, count):
    return [stored.part(position, position + 1).rows for position in range(count)]


def assert_comes_back(power_dbm):
    """Pack and unpack, compare bits, return the bytes of a row."""
    stored = pack_powers(power_dbm)
    assert len(stored.rows) == stored.width * len(power_dbm)
    assert stored.width <= 4 * power_dbm.shape[1]
    rows = rows_of(stored, len(power_dbm))
    expected = canonical_powers(power_dbm).view("<u4")
    np.testing.assert_array_equal(unpack_powers(rows).view("<u4"), expected)
    np.testing.assert_array_equal(unpack_powers(rows[-1:]).view("<u4"), expected[-1:])
    return stored.width


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=ANY)
def test_any_bits_come_back(power_dbm):
    assert_comes_back(power_dbm.astype(np.float32))


@st.composite
def gridded(draw):
    """Levels on a grid, with some values of any kind among them."""
    shape = draw(SHAPES)
    steps = draw(arrays(np.int32, shape, elements=st.integers(-(10**7), 10**6)))
    scale = draw(st.sampled_from([1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 2.0**17, 2.0**23, 3.0]))
    power_dbm = (steps / scale).astype(np.float32)
    odd = draw(arrays(np.bool_, shape, elements=st.sampled_from([False] * 9 + [True]), fill=st.just(False)))
    power_dbm[odd] = draw(st.sampled_from([np.nan, -0.0, 0.0, 1e-45, -1e-40, 1.1754944e-38, 3.4e38, 1e-5, -59.08]))
    return power_dbm


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=gridded())
def test_levels_on_a_grid_come_back(power_dbm):
    assert_comes_back(power_dbm)


@pytest.mark.parametrize(
    ("decimals", "most_bytes"),
    [(2, 50), (3, 66), (5, 90), (None, 98)],
    ids=["0.01", "0.001", "0.00001", "full mantissa"],
)
@pytest.mark.parametrize("missing", [0, 1, 40])
def test_levels_of_carriers_take_the_bits_of_their_span(decimals, most_bytes, missing):
    rng = np.random.default_rng(5)
    power_dbm = POWER_LEVELS + rng.normal(0.0, 0.1, (50, 32))
    power_dbm = (power_dbm if decimals is None else np.round(power_dbm, decimals)).astype(np.float32)
    power_dbm.reshape(-1)[:missing] = np.nan
    assert assert_comes_back(power_dbm) <= most_bytes


def test_a_row_without_powers_is_a_row():
    assert assert_comes_back(np.full((3, 32), np.nan, dtype=np.float32)) < 32


def test_a_sign_of_zero_or_a_value_off_every_grid_costs_the_plain_form():
    for odd in (-0.0, 1e-44):
        power_dbm = np.round(POWER_LEVELS, 2).astype(np.float32)[None].copy()
        power_dbm[0, 3] = odd
        assert assert_comes_back(power_dbm) == 128


def test_rows_of_any_form_and_plan_are_read_together():
    wide, narrow = np.round(POWER_LEVELS, 2).astype(np.float32)[None], np.full((1, 3), -50.5, dtype=np.float32)
    many = np.round(np.linspace(-60, -50, 7), 5).astype(np.float32)[None]
    plain = many + np.float32(np.pi) * np.float32(1e-30)
    of_rows = [wide, narrow, wide + np.float32(1), many, plain, wide.astype(np.float16).astype(np.float32)]
    found = {}
    for positions, part in unpack_parts([pack_powers(row).rows for row in of_rows]):
        found.update(zip(positions, part, strict=True))
    for position, row in enumerate(of_rows):
        np.testing.assert_array_equal(found[position], row[0])
    same_plan = [of_rows[position] for position in (0, 2, 5, 0)]
    np.testing.assert_array_equal(unpack_powers([pack_powers(row).rows for row in same_plan]), np.vstack(same_plan))


def test_plain_rows_of_older_versions_are_read():
    plain = np.array([-50.25, np.nan, -0.0], dtype="<f4")
    np.testing.assert_array_equal(unpack_powers([plain.tobytes()])[0].view("<u4"), plain.view("<u4"))
    masks = np.array([0, 1 << 22, -1], dtype="<i4")
    assert unpack_flags(masks.tobytes(), 3).tolist() == masks.tolist()


@settings(max_examples=examples(200), deadline=None)
@given(masks=arrays(np.int32, SHAPES, elements=st.one_of(st.just(0), st.integers(-(1 << 31), (1 << 31) - 1))))
def test_flags_come_back(masks):
    stored = pack_flags(masks)
    assert stored.width <= 4 * masks.shape[1]
    for row, mask in zip(rows_of(stored, len(masks)), masks, strict=True):
        assert unpack_flags(row, masks.shape[1]).tolist() == mask.tolist()


def test_flags_take_no_bytes_where_none_is_set_and_few_where_they_are_small():
    masks = np.zeros((2, 32), dtype=np.int32)
    assert pack_flags(masks) == NO_FLAGS
    masks[1, 4] = 16
    assert pack_flags(masks).width <= 6 + 20 + 1


@settings(max_examples=examples(300), deadline=None)
@given(power_dbm=gridded())
def test_a_row_alone_is_packed_as_one_of_many(power_dbm):
    for row in canonical_powers(power_dbm):
        assert pack_powers(row[None, :]) == _many_rows(canonical_powers(row[None, :]))


def test_a_row_alone_is_packed_value_by_value_where_levels_have_few_decimals():
    row = np.round(POWER_LEVELS, 2).astype(np.float32)[None, :]
    assert _one_row(row) == _many_rows(row)
    for odd in (np.nan, np.inf, -0.0):
        assert _one_row(np.append(row, np.float32(odd))[None, :]) is None


SEGMENT_KINDS = 4


@st.composite
def sealed_rows(draw):
    count, carriers = draw(st.integers(1, 12)), draw(st.integers(1, 5))
    integers = [draw(hnp.arrays(np.int64, count, elements=INT64)) for _ in range(4)]
    claims = [draw(hnp.arrays(np.bool_, count)) for _ in range(5)]
    powers = draw(hnp.arrays(np.uint32, (count, carriers))).view(np.float32)
    flags = draw(hnp.arrays(np.int32, (count, carriers)))
    details = draw(
        hnp.arrays(np.float32, (count, SEGMENT_KINDS, carriers), elements=st.floats(width=32, allow_nan=True))
    )
    return SealedRows._make((*integers, *claims, powers, flags, details))


@settings(derandomize=True, deadline=None)
@given(rows=sealed_rows())
def test_every_bit_of_a_segment_comes_back(rows):
    blobs = pack(rows)
    columns = unpack_columns(blobs.columns, len(rows.epochs_us))
    for name, column in columns._asdict().items():
        np.testing.assert_array_equal(column, getattr(rows, name), name)
    powers = segments.unpack_powers(blobs.powers, len(rows.epochs_us))
    assert powers.tobytes() == rows.power_dbm.tobytes()
    if blobs.extras is None:
        assert not rows.has_flags.any()
        assert not rows.has_details.any()
        return
    extras: Extras = unpack_extras(blobs.extras, columns, rows.power_dbm.shape[1])
    np.testing.assert_array_equal(extras.flags, rows.flags[rows.has_flags])
    # any NaN is "not stated"
    np.testing.assert_array_equal(extras.details, rows.details[rows.has_details])


def steady(count: int, carriers: int) -> SealedRows:
    """Return rows of a front end that measures every ten seconds, levels of two decimals."""
    random = np.random.default_rng(5)
    step = np.arange(count)
    yes, no = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    epochs_us = 1_795_000_000_000_000 + step * 10_000_000
    powers = np.round(random.normal(-60.0, 0.1, (count, carriers)), 2).astype(np.float32)
    flags, details = (
        np.zeros((count, carriers), np.int32),
        np.full((count, SEGMENT_KINDS, carriers), np.nan, np.float32),
    )
    return SealedRows(epochs_us, step + 5, epochs_us + 40_000, step, yes, no, yes, no, no, powers, flags, details)


def test_a_day_of_two_decimals_takes_a_third_of_its_powers():
    rows = steady(8640, 32)
    blobs = pack(rows)
    size = len(blobs.columns) + len(blobs.powers)
    # measured 0.25 of the powers, spec/performance.md asks for 0.35
    assert size <= 0.30 * rows.power_dbm.nbytes, f"{size / rows.power_dbm.nbytes:.3f}"
    # four columns of integers and five claims of a steady day are next to nothing
    assert len(blobs.columns) < 8640


def head_of(rows: SealedRows) -> SegmentHead:
    first, last = int(rows.epochs_us[0]), int(rows.epochs_us[-1])
    count = len(rows.epochs_us)
    numbers = int(rows.numbers[0]), int(rows.numbers[-1])
    return SegmentHead(1, 1, 1, 1, 20_000, count, count, first, last, *numbers, CODEC, 0)


@pytest.mark.parametrize("part", ["columns", "powers"])
def test_any_wrong_bit_changes_the_checksum(part):
    rows = steady(20, 4)
    blobs, head = pack(rows), head_of(rows)
    right = crc32_of(head, blobs)
    blob = getattr(blobs, part)
    for position in range(8 * len(blob)):
        wrong = bytearray(blob)
        wrong[position // 8] ^= 1 << position % 8
        assert crc32_of(head, blobs._replace(**{part: bytes(wrong)})) != right, position


def test_every_figure_of_the_head_is_under_the_checksum():
    rows = steady(20, 4)
    blobs, head = pack(rows), head_of(rows)
    right = crc32_of(head, blobs)
    for name in head._fields:
        changed = crc32_of(head._replace(**{name: getattr(head, name) + 1}), blobs)
        assert (changed == right) == (name in ("segment_id", "crc32")), name


def test_what_is_no_zstd_or_has_another_length_is_a_value_error():
    rows = steady(20, 4)
    with pytest.raises(ValueError, match="bytes"):
        unpack_columns(pack(rows).columns, 21)
    with pytest.raises(ValueError, match=r"decompress|frame"):
        unpack_columns(b"nothing", 20)


def test_the_cache_holds_what_fits_and_tells_contents_of_one_id_apart():
    rows = steady(100, 4)
    blobs: Blobs = pack(rows)
    cache, head = SegmentCache(size_bytes=20_000), head_of(rows)
    chunks = [SimpleNamespace(position=position) for position in range(4)]
    for position, chunk in enumerate(chunks):
        cache.put(head._replace(segment_id=position), chunk, 4)
    # 6400 bytes each: three fit, what was not asked for longest is gone
    assert [cache.get(head._replace(segment_id=position)) for position in range(4)] == [None, *chunks[1:]]
    assert cache.get(head._replace(segment_id=1)) is chunks[1]
    cache.put(head._replace(segment_id=9), chunks[0], 4)
    assert cache.get(head._replace(segment_id=2)) is None
    assert cache.get(head._replace(segment_id=1, crc32=7)) is None, "an id that came again after a roll-back"
    cache.put(head._replace(segment_id=10), SegmentChunk(head, "sa-1", blobs), 4000)
    assert cache.get(head._replace(segment_id=10)) is not None, "one is held whatever it takes"
    cache.clear()
    assert cache.get(head._replace(segment_id=10)) is None


S = 1_000_000
RNG = np.random.default_rng(7)


@pytest.mark.parametrize(("step_us", "buckets"), [(60 * S, 24), (20 * S, 24), (19 * S, 24)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_levels_and_rows_come_back(step_us, buckets, dtype):
    epochs_us = 5 * 86_400 * S + np.arange(0, 86_400 * S, step_us)
    values = RNG.normal(size=(len(epochs_us), 3)).astype(dtype)
    values[RNG.random(values.shape) < 0.1] = np.nan
    made = pack_day(epochs_us, values, 2)
    hours = unpack_level(made.hours)
    rows = Summaries.of_rows(epochs_us, values)
    for found, wanted in zip(hours.buckets, rows.gathered(epochs_us // (3600 * S)), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert len(hours.starts) == buckets
    assert unpack_level(made.day).buckets.counts.tolist() == [np.isfinite(values).sum(axis=0).tolist()]
    level, frames = hours, made.row_frames
    if step_us < 20 * S:
        level = unpack_level(made.minute_frames[hours.starts[3] : hours.starts[3] + hours.sizes[3]])
        assert len(level.starts) == 60
    else:
        assert made.minute_frames is None
    opened = unpack_rows(frames[level.starts[3] : level.starts[3] + level.sizes[3]])
    first = np.searchsorted(epochs_us, opened.epochs_us[0])
    assert level.buckets.first_us[3] == opened.epochs_us[0]
    assert opened.values.dtype == dtype
    np.testing.assert_array_equal(opened.epochs_us, epochs_us[first : first + len(opened.epochs_us)])
    np.testing.assert_array_equal(opened.values, values[first : first + len(opened.epochs_us), :2])


def test_a_bit_flipped_anywhere_is_found():
    epochs_us = np.arange(0, 3600 * S, 300 * S)
    made = pack_day(epochs_us, RNG.normal(size=(len(epochs_us), 1)), 1)
    for blob, unpack in ((made.hours, unpack_level), (made.row_frames, unpack_rows)):
        # the first bytes name the format and the sizes; damage there is found by the reader of zstd too
        for position in range(len(blob)):
            spoilt = bytearray(blob)
            spoilt[position] ^= 1 << int(RNG.integers(8))
            try:
                found = unpack(bytes(spoilt))
            except ValueError:
                continue
            for one, other in zip(flat(found), flat(unpack(blob)), strict=True):
                np.testing.assert_array_equal(one, other)


def flat(found):
    """Return the arrays of what was unpacked."""
    return [*found[0], *found[1:]] if isinstance(found[0], Summaries) else list(found)


CARRIERS = 16
ROWS = 100


def head(number: int) -> SegmentHead:
    return SegmentHead(number, 1, 1, 1, number, ROWS, ROWS, 0, 1, 1, ROWS, 1, 7)


def chunk(number: int) -> SegmentChunk:
    return cast("SegmentChunk", ("piece", number))


def held(cache: SegmentCache) -> list[int]:
    return [number for number in range(1, 10) if cache.get(head(number)) is not None]


def filled(cache: Any, *numbers: int) -> Any:
    for number in numbers:
        cache.put(head(number), chunk(number), CARRIERS)
    return cache


def test_what_was_not_read_for_longest_goes():
    cache = filled(SegmentCache(3 * ROWS * (4 * CARRIERS + 48)), 1, 2, 3)
    cache.get(head(1))
    filled(cache, 4)
    assert held(cache) == [1, 3, 4]


def test_a_scan_finds_what_is_held_adds_nothing_and_keeps_its_last_piece():
    shared = filled(SegmentCache(), 1, 2)
    scan = filled(shared.for_scan(), 3, 4)
    assert held(scan) == [1, 2, 4]
    assert scan.get(head(4)) == chunk(4)
    assert held(shared) == [1, 2]
