"""Every storage takes measurements once: counted exactly, journaled without gaps, kept bit for bit."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.errors import ForbiddenError, InvalidInputError, NotFoundError
from service.ports.archive import ListPart
from service.records.calibration import Window
from service.records.catalogue import Carrier
from service.records.levels.measurement import DETAIL_NAMES, BatchReceipt, CarrierDetails, Measurement, Sender

EXAMPLES = settings(
    derandomize=True,
    deadline=None,
    max_examples=examples(25),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def test_rows_come_back_as_float32_with_absent_carriers(setting):
    sent = np.array([[-50.1, np.nan, -0.0], [-250.0, 1e-30, np.nan]], dtype=np.float32)
    assert setting.append([10, 20], sent) == BatchReceipt(2, 0, 0, ())
    stored = np.array([row.power_dbm for row in setting.rows()])
    # widened float32: no tolerance, the sign of zero included
    assert stored.astype(np.float32).tobytes() == sent.tobytes()


def test_stored_arrays_are_read_only(setting):
    setting.append([10], flags=[(1, 2, 3)])
    (row,) = setting.rows()
    for array in (row.power_dbm, row.flags):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_a_row_carries_source_plan_sequence_and_receipt(setting):
    setting.append([10, 20, 30], index=[0, 2, 3], first_seq=100, source="sa-7")
    rows = setting.rows()
    assert [row.seq for row in rows] == [100, 102, 103]
    assert {(row.source, row.plan_id, row.received_at_us) for row in rows} == {("sa-7", setting.plan_id, 77)}
    assert [row.number for row in rows] == [4, 5, 6]


def test_rows_with_and_without_flags_mix_in_one_batch(setting):
    flags = [(0, 16, 1 << 22), None, None, (1, 2, 3), None]
    setting.append([10, 20, 30, 40, 50], flags=flags)
    stored = [None if row.flags is None else tuple(row.flags.tolist()) for row in setting.rows()]
    assert stored == flags


def stated(rows: int) -> np.ndarray:
    """Figures of three kinds; the fourth, the bandwidth, is never stated."""
    figures = np.arange(4 * rows * 3, dtype=np.float32).reshape(4, rows, 3) + np.float32(0.1)
    figures[2] = np.nan
    return figures


def test_details_come_back_as_float32_with_the_rows_that_state_any(setting):
    figures = stated(4)
    # one row states nothing, one is a duplicate: neither may shift the others
    figures[:, 1] = np.nan
    setting.append([30], -3.0)
    setting.append([10, 20, 30, 40], [-1.0, -2.0, -3.0, -4.0], details=CarrierDetails(*figures))
    rows = setting.rows()
    assert [row.details is None for row in rows] == [False, True, True, False]
    for row, position in ((rows[0], 0), (rows[3], 3)):
        reported = np.array([getattr(row.details, name) for name in DETAIL_NAMES])
        # widened float32: no tolerance
        np.testing.assert_array_equal(reported.astype(np.float32), figures[:, position])
        with pytest.raises(ValueError, match="read-only"):
            row.details.sigma_db[0] = 0
    assert setting.storage.archive.newest_measurement(setting.id).details is not None
    assert [entry.content.details is None for entry in setting.storage.archive.journal(setting.id, 3, 9)] == [
        True,
        False,
        True,
        False,
    ]


def test_other_details_of_a_known_row_are_a_conflict(setting):
    figures = stated(2)
    setting.append([10, 20], details=CarrierDetails(*figures))
    assert setting.append([10, 20], details=CarrierDetails(*figures)) == BatchReceipt(0, 2, 0, ())
    # a kind that only another row of the batch states is no other content
    more = np.concatenate((figures, np.full((4, 1, 3), 7.0, dtype=np.float32)), axis=1)
    assert setting.append([10, 20, 30], details=CarrierDetails(*more)).duplicates == 2
    other = figures[:, :1].copy()
    other[3, 0, 2] += 1
    for details in (None, CarrierDetails(*other)):
        assert setting.append([10], details=details).refused[0].code == "measurement.conflict"
    setting.append([40])
    assert setting.append([40], details=CarrierDetails(*other)).refused[0].code == "measurement.conflict"
    nothing = CarrierDetails(*np.full((4, 1, 3), np.nan, dtype=np.float32))
    assert setting.append([40], details=nothing).duplicates == 1


def test_the_same_powers_under_another_plan_are_a_conflict(setting, make):
    setting.append([10])
    first = setting.plan_id
    setting.plan_id = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned").id
    receipt = setting.append([10, 20])
    assert (receipt.accepted, receipt.duplicates) == (1, 0)
    assert receipt.refused[0].code == "measurement.conflict"
    assert setting.rows()[0].plan_id == first


LEAP = (1 << 23,) * 3


@pytest.mark.parametrize("is_leap_first", [True, False])
def test_a_row_of_a_leap_second_and_the_one_of_its_epoch_are_both_kept(setting, is_leap_first):
    ways = [{"power_dbm": -51.0, "flags": [LEAP]}, {"power_dbm": -50.0}]
    first, second = ways if is_leap_first else ways[::-1]
    assert setting.append([500], **first) == BatchReceipt(1, 0, 0, ())
    receipt = setting.append([500], **second)
    assert (receipt.accepted, [each.code for each in receipt.flagged]) == (1, ["time.leap_second"])
    for way in ways:
        assert setting.append([500], **way) == BatchReceipt(0, 1, 0, ())
    assert setting.append([500], -52.0).refused[0].code == "measurement.conflict"
    found = [(row.epoch_us, row.power_dbm[0]) for row in setting.rows()]
    assert found == [(500, first["power_dbm"]), (501, second["power_dbm"])]
    assert [None if row.flags is None else tuple(row.flags) for row in setting.rows()] == [
        LEAP if is_leap_first else None,
        LEAP,
    ]


def test_a_leap_second_within_one_batch_keeps_every_row(setting):
    epochs_us, powers = [100, 200, 300, 200, 300, 400], [-50.0, -51.0, -52.0, -53.0, -54.0, -55.0]
    flags = [None, LEAP, LEAP, None, None, None]
    receipt = setting.append(epochs_us, powers, flags=flags, first_seq=1)
    assert (receipt.accepted, [each.index for each in receipt.flagged]) == (6, [3, 4])
    assert setting.append(epochs_us, powers, flags=flags, first_seq=1).duplicates == 6
    assert [(row.epoch_us, row.seq) for row in setting.rows()] == [
        (100, 1), (200, 2), (201, 4), (300, 3), (301, 5), (400, 6)
    ]  # fmt: skip


def test_a_sealed_row_is_compared_by_its_whole_content(setting, make):
    figures = CarrierDetails(*stated(1))
    setting.append([10], details=figures, flags=[(0, 1, 0)])
    setting.append([20], np.array([[0.0, -51.0, np.nan]]))
    day_us = 86_400_000_000
    assert sum(1 for _ in setting.storage.archive.seal(setting.id, 2 * day_us, 2**60)) > 0
    assert setting.append([10], details=figures, flags=[(0, 1, 0)]).duplicates == 1
    assert setting.append([20], np.array([[-0.0, -51.0, np.nan]])).duplicates == 1
    assert setting.append([10], flags=[(0, 1, 0)]).refused[0].code == "measurement.conflict"
    setting.plan_id = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned").id
    assert setting.append([20], np.array([[0.0, -51.0, np.nan]])).refused[0].code == "measurement.conflict"


def test_details_of_two_sources_stay_apart(setting):
    setting.append([10], details=CarrierDetails(*stated(1)))
    setting.append([10], source="sa-2")
    assert [row.details is None for row in setting.rows()] == [False, True]


def test_every_nan_is_the_same_absence(setting):
    quiet, odd = struct.unpack("<2f", struct.pack("<2I", 0x7FC00000, 0x7FC12345))
    first = np.array([[quiet, 1.0, 2.0]], dtype=np.float32)
    second = np.array([[odd, 1.0, 2.0]], dtype=np.float32)
    setting.append([10], first)
    assert setting.append([10], second).duplicates == 1


def test_another_content_under_the_same_key_is_refused_and_the_first_stays(setting):
    setting.append([10, 20], [-50.0, -51.0])
    receipt = setting.append([10, 20, 30], [-50.0, -51.5, -52.0], index=[0, 3, 4], first_seq=7)
    assert (receipt.accepted, receipt.duplicates) == (1, 1)
    (refusal,) = receipt.refused
    assert (refusal.index, refusal.seq, refusal.code) == (3, 10, "measurement.conflict")
    # -51 is exact in float32
    assert setting.rows()[1].power_dbm[0] == -51.0


def test_other_flags_are_another_content(setting):
    setting.append([10], flags=[(0, 0, 1)])
    assert setting.append([10], flags=[(0, 0, 2)]).refused[0].code == "measurement.conflict"
    assert setting.append([10]).refused[0].code == "measurement.conflict"
    assert setting.append([10], flags=[(0, 0, 1)]).duplicates == 1


def test_a_batch_that_repeats_an_epoch_keeps_its_first_row(setting):
    receipt = setting.append([10, 10, 10], [-50.0, -50.0, -51.0])
    assert (receipt.accepted, receipt.duplicates, len(receipt.refused)) == (1, 1, 1)


def test_below_the_newest_consumed_epoch_is_late(setting):
    setting.append([100])
    setting.consume()
    receipt = setting.append([99, 101])
    assert (receipt.accepted, receipt.late) == (2, 1)
    assert [row.is_late for row in setting.rows()] == [True, False, False]


def test_the_consumed_epoch_itself_from_another_source_is_not_late(setting):
    setting.append([100])
    setting.consume()
    assert setting.append([100], source="sa-2").late == 0


def test_stale_rows_are_late(setting):
    receipt = setting.append([10, 20, 30], is_stale=[False, True, False])
    assert receipt.late == 1
    assert [row.is_late for row in setting.rows()] == [False, True, False]


def test_an_empty_batch_changes_nothing(setting):
    assert setting.append([]) == BatchReceipt(0, 0, 0, ())
    assert (setting.storage.archive.sources(setting.id), setting.storage.archive.every_source()) == ((), {})


def test_an_unknown_plan_and_a_wrong_number_of_carriers_are_refused(setting):
    setting.plan_id = 99
    with pytest.raises(NotFoundError) as caught:
        setting.append([10])
    assert caught.value.code == "plan.unknown"
    setting.plan_id = setting.storage.catalogue.put_plan(setting.id, [Carrier("x", "C", "t", 1e9, 1e6)], "x").id
    with pytest.raises(InvalidInputError) as wrong:
        setting.append([10])
    assert wrong.value.code == "value.count"


def test_the_first_source_feeds_and_selection_moves_the_feed(setting):
    archive = setting.storage.archive
    setting.append([10])
    setting.append([20], source="sa-2")
    assert archive.select_source(setting.id, "sa-2").role == "prime"
    setting.append([30])
    setting.append([40], source="sa-2")
    assert [row.feeds_estimator for row in setting.rows()] == [True, False, False, True]
    assert [(s.id, s.role, s.newest_epoch_us, s.rows) for s in archive.sources(setting.id)] == [
        ("sa-1", "backup", 30, 2),
        ("sa-2", "prime", 40, 2),
    ]
    assert archive.every_source() == {setting.id: list(archive.sources(setting.id))}
    with pytest.raises(NotFoundError) as caught:
        archive.select_source(setting.id, "sa-3")
    assert caught.value.code == "source.unknown"


def test_the_newest_measurement_is_that_of_the_prime_source(setting):
    archive = setting.storage.archive
    assert archive.newest_measurement(setting.id) is None
    setting.append([10, 30, 20], [-50.0, -51.0, -52.0])
    setting.append([40], source="sa-2")
    assert archive.newest_measurement(setting.id).epoch_us == 30
    archive.select_source(setting.id, "sa-2")
    assert archive.newest_measurement(setting.id).epoch_us == 40


def test_pages_of_measurements_join_without_gap_or_overlap(setting):
    setting.append([30, 10, 20], [-1.0, -2.0, -3.0])
    setting.append([20, 10], source="sa-2")
    archive, pages, after = setting.storage.archive, [], None
    while page := archive.measurements(setting.id, ListPart(Window(10, 30), 3, after)):
        pages.append([(row.epoch_us, row.number) for row in page])
        after = pages[-1][-1]
    assert pages == [[(10, 5), (10, 8), (20, 6)], [(20, 7)]]
    only = archive.measurements(setting.id, ListPart(Window(0, 99), 9), "sa-2")
    assert [row.number for row in only] == [8, 7]


def test_rows_after_an_epoch_are_those_that_feed_and_are_older_in_the_journal(setting):
    setting.append([10, 40, 30], [-1.0, -2.0, -3.0])
    setting.append([35], source="sa-2")
    setting.append([50])
    rows = list(setting.storage.archive.measurements_after(setting.id, 10, before_number=8))
    assert [(row.epoch_us, row.number) for row in rows] == [(30, 6), (40, 5)]


def test_series_match_columns_by_carrier_id_across_plans(setting, make):
    setting.append([20, 10], np.array([[-1.0, -2.0, -3.0], [-4.0, np.nan, -6.0]]))
    setting.append([15], source="sa-2")
    turned = setting.storage.catalogue.put_plan(setting.id, make.carriers[::-1], "turned")
    setting.plan_id = turned.id
    setting.append([30], np.array([[-7.0, -8.0, -9.0]]))
    series = setting.storage.archive.measurement_series(setting.id, Window(0, 31), ["c02", "none", "c01"])
    assert series.epochs_us.tolist() == [10, 20, 30]
    # small whole numbers are exact in float32
    np.testing.assert_array_equal(
        series.power_dbm, [[-6.0, np.nan, np.nan], [-3.0, np.nan, -2.0], [-7.0, np.nan, -8.0]]
    )


def test_parts_of_a_series_are_the_series(setting, monkeypatch):
    monkeypatch.setattr("db.measurements.archive.BLOCK_PAGE_ROWS", 3)
    setting.append(range(10, 90, 10))
    asked = setting.id, Window(0, 71), ["c02", "none", "c01"]
    parts = list(setting.storage.archive.measurement_parts(*asked))
    series = setting.storage.archive.measurement_series(*asked)
    assert [len(part.epochs_us) for part in parts] == [3, 3, 1]
    np.testing.assert_array_equal(np.concatenate([part.epochs_us for part in parts]), series.epochs_us)
    np.testing.assert_array_equal(np.concatenate([part.power_dbm for part in parts]), series.power_dbm)


def test_an_empty_series_has_its_columns(setting):
    series = setting.storage.archive.measurement_series(setting.id, Window(0, 1), ["c00", "c01"])
    assert series.power_dbm.shape == (0, 2)


def test_head_tells_where_journal_and_consumer_stand(setting):
    setting.append([30, 10])
    head = setting.storage.archive.head(setting.id)
    assert (head.newest_number, head.consumed_number, head.newest_epoch_us, head.consumed_epoch_us) == (5, 0, 30, None)
    setting.consume()
    head = setting.storage.archive.head(setting.id)
    assert (head.consumed_number, head.consumed_epoch_us) == (5, 30)


@EXAMPLES
@given(
    batches=st.lists(
        st.tuples(
            st.sampled_from(["sa-1", "sa-2"]),
            st.lists(st.tuples(st.integers(1, 12), st.sampled_from([-50.0, -51.0, float("nan")]), st.booleans())),
            st.booleans(),
        ),
        max_size=8,
    )
)
def test_any_interleaving_is_counted_exactly_and_numbered_without_gaps(new_setting, batches):
    """Model: a dictionary of first contents by (source, epoch), and the epoch consumed so far."""
    setting = new_setting()
    kept: dict[tuple[str, int], tuple[str, bool]] = {}
    numbers: list[tuple[str, int, bool]] = []
    consumed = -1
    for source, rows, is_consumed_after in batches:
        late = duplicates = conflicts = 0
        for epoch_us, power_dbm, has_flags in rows:
            content = (repr(power_dbm), has_flags)
            if (source, epoch_us) not in kept:
                kept[source, epoch_us] = content
                numbers.append((source, epoch_us, epoch_us < consumed))
                late += epoch_us < consumed
            elif kept[source, epoch_us] == content:
                duplicates += 1
            else:
                conflicts += 1
        flags = [(0, 0, 16) if has_flags else None for _, _, has_flags in rows]
        receipt = setting.append([row[0] for row in rows], [row[1] for row in rows], source=source, flags=flags)
        assert len(receipt.refused) == conflicts
        assert (receipt.duplicates, receipt.late) == (duplicates, late)
        assert receipt.accepted + receipt.duplicates + len(receipt.refused) == len(rows)
        if is_consumed_after and numbers:
            setting.consume()
            consumed = max(epoch_us for _, epoch_us, _ in numbers)
    entries = setting.storage.archive.journal(setting.id, 3, 1000)
    assert [entry.number for entry in entries] == list(range(4, 4 + len(numbers)))
    contents = [entry.content for entry in entries]
    assert all(isinstance(content, Measurement) for content in contents)
    assert [(content.source, content.epoch_us, content.is_late) for content in contents] == numbers
    stored = {source.id: source.rows for source in setting.storage.archive.sources(setting.id)}
    assert sum(stored.values()) == len(kept)


def test_rows_of_another_station_are_refused_among_those_of_many_front_ends(setting):
    """Written together or alone, on either database: one that is not theirs keeps no other row from being stored."""

    def send(source, key_id, station, epoch_us):
        batch = replace(setting.batch([epoch_us], source=source), sender=Sender(key_id, 9, station))
        return setting.storage.archive.append_measurements(batch)

    for k in range(3):
        assert send(f"sa-{k}", f"k{k}", f"north-{k}", 10).result(60).accepted == 1
    asked = [
        (send(f"sa-{k}", key_id, station, epoch_us), station == f"north-{k}")
        for epoch_us in range(20, 40)
        for k in range(3)
        # an honest row, a forged one before it and one behind
        for key_id, station in (("x", "south"), (f"k{k}" if epoch_us < 30 else "new", f"north-{k}"), ("x", "south"))
    ]
    for future, is_own in asked:
        if is_own:
            assert future.result(60).accepted == 1
        else:
            with pytest.raises(
                ForbiddenError, match=r"source\.not_yours: Source 'sa-\d' belongs to station 'north-\d'"
            ):
                future.result(60)
    rows = setting.rows()
    assert len(rows) == 63
    for row in rows:
        k = row.source.removeprefix("sa-")
        assert (row.key_id, row.station) == ("new" if row.epoch_us >= 30 else f"k{k}", f"north-{k}")
    # sealed rows know their keys too
    assert sum(part.rows for part in setting.storage.archive.seal(setting.id, 1 << 60, 1 << 60)) == 63
    assert repr(setting.rows()) == repr(rows)
    sources = setting.storage.archive.sources(setting.id)
    assert [(each.station, each.key_id) for each in sources] == [(f"north-{k}", "new") for k in range(3)]


def test_a_key_makes_so_many_sources_and_goes_on_under_those(setting):
    def send(source, key_id, epoch_us):
        batch = replace(setting.batch([epoch_us], source=source), sender=Sender(key_id, 2))
        return setting.storage.archive.append_measurements(batch).result(timeout=120).accepted

    setting.append([1], source="without a key")
    assert [send(f"sa-{k}", "k1", 10 + k) for k in range(2)] == [1, 1]
    for k in range(3):
        with pytest.raises(InvalidInputError) as caught:
            send(f"new-{k}", "k1", 20 + k)
        assert caught.value.code == "source.too_many"
    # sources that are there are anybody's, and every key has a number of its own
    assert [send(name, "k1", 30) for name in ("sa-0", "sa-1", "without a key")] == [1, 1, 1]
    assert send("sa-2", "k2", 40) == 1
    assert [source.id for source in setting.storage.archive.sources(setting.id)] == [
        "without a key",
        "sa-0",
        "sa-1",
        "sa-2",
    ]
    assert len(setting.rows()) == 7
