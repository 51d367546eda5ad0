"""Every storage counts the rows that a source has numbered and not delivered, and forgets none that comes later."""

import random
from itertools import pairwise

import pytest

from service.records.calibration import Window


def missing(setting, source: str = "sa-1") -> int | None:
    return next(s.rows_missing for s in setting.storage.archive.sources(setting.id) if s.id == source)


def send(setting, seqs, *, epoch_of=lambda seq: 100 + seq, **options) -> None:
    """Send rows of consecutive numbers as one batch."""
    epochs_us = [epoch_of(seq) for seq in seqs]
    setting.append(epochs_us, [-50.0 - epoch_us / 8 for epoch_us in epochs_us], first_seq=seqs[0], **options)


def test_a_source_without_numbers_misses_nothing_that_could_be_told(setting):
    setting.append([10, 20])
    assert missing(setting) is None


def test_batches_that_follow_each_other_miss_nothing(setting):
    for first in (1042, 1052, 1062):
        send(setting, range(first, first + 10))
    assert missing(setting) == 0


def test_a_gap_is_counted_and_closes_as_rows_come(setting):
    send(setting, range(10))
    send(setting, range(30, 40))
    assert missing(setting) == 20
    send(setting, range(15, 20))
    assert missing(setting) == 15
    send(setting, range(10, 15))
    send(setting, range(20, 30))
    assert missing(setting) == 0


def test_rows_before_the_first_ever_held_are_not_known_to_be_missing_until_one_of_them_comes(setting):
    send(setting, range(900, 910))
    assert missing(setting) == 0
    send(setting, range(5))
    assert missing(setting) == 895
    send(setting, range(5, 900))
    assert missing(setting) == 0


def test_a_duplicate_changes_nothing_and_a_refused_row_stays_missing(setting):
    send(setting, range(10))
    send(setting, range(10))
    assert missing(setting) == 0
    # row 12 of the request was refused by screening: its place is not in the batch
    setting.append([110, 111, 113], -1.0, index=[0, 1, 3], first_seq=10)
    assert missing(setting) == 1


def test_rows_held_under_another_number_do_not_look_lost(setting):
    """A station that lost its counter sends again what the archive has, in the middle of what it has not."""
    send(setting, range(5), epoch_of=lambda seq: 100 + 10 * seq)
    powers = [-50.0 - epoch_us / 8 for epoch_us in (90, 95, 100, 105)]
    receipt = setting.append([90, 95, 100, 105], powers, first_seq=70)
    assert (receipt.accepted, receipt.duplicates) == (3, 1)
    assert missing(setting) == 65


def test_numbers_that_start_anew_are_a_new_run_and_both_runs_keep_their_gaps(setting):
    send(setting, range(10))
    send(setting, range(15, 20))
    assert missing(setting) == 5
    later = {"epoch_of": lambda seq: 1000 + seq}
    send(setting, range(3), **later)
    assert missing(setting) == 5
    send(setting, range(8, 12), **later)
    assert missing(setting) == 10
    # rows of the earlier run find their gap by their epoch
    send(setting, range(10, 15))
    assert missing(setting) == 5
    send(setting, range(3, 8), **later)
    assert missing(setting) == 0


def test_a_source_that_always_says_number_zero_neither_misses_nor_grows_without_end(setting):
    for k in range(40):
        send(setting, range(3), epoch_of=lambda seq, k=k: 100 * (k + 1) + seq)
    assert missing(setting) == 0
    assert len(setting.rows()) == 120


def test_sources_are_counted_apart(setting):
    send(setting, range(3))
    send(setting, range(7, 9), source="sa-2")
    send(setting, range(5, 9))
    assert (missing(setting), missing(setting, "sa-2")) == (2, 0)


@pytest.mark.parametrize("seed", range(6))
def test_in_whatever_order_blocks_come_the_count_is_that_of_the_stored_rows(setting, seed):
    """Two runs of 120 rows, sent in blocks in any order, some twice and some never."""
    rng = random.Random(seed)
    expected = 0
    for run in range(2):
        rows = range(120)
        cuts = sorted({0, 120, *rng.sample(rows, 25)})
        blocks = [rows[start:stop] for start, stop in pairwise(cuts)]
        sent = [block for block in blocks[1:-1] if rng.random() < 0.7]
        rng.shuffle(sent)
        # a run is known by its first number after the last of the one before, and is over with its last
        order = [blocks[0], *sent, blocks[-1], *sent[:3]] if run == 0 else [blocks[0], blocks[-1], *sent]
        for block in order:
            send(setting, block, epoch_of=lambda seq, run=run: 1000 * (run + 1) + seq)
        held = set().union(*order)
        expected += 120 - len(held)
        assert missing(setting) == expected, f"seed {seed} run {run}"
    stored = setting.storage.archive.measurements(setting.id, Window(0, 1 << 60), 1000, None)
    assert len(stored) == 240 - expected


def test_a_jump_of_more_than_a_thousand_million_numbers_is_flagged_and_counts_no_gap(setting):
    send(setting, range(10))
    far = 2**52
    receipt = setting.append([500, 501], [-1.0, -2.0], first_seq=far)
    assert receipt.accepted == 2
    assert [(each.index, each.seq, each.code) for each in receipt.flagged] == [(0, far, "seq.jump")]
    assert missing(setting) == 0
    # numbers go on either way, and gaps of this run are counted again
    assert setting.append([502], -3.0, first_seq=far + 4).flagged == ()
    assert missing(setting) == 2
    assert setting.append([600], -3.0, first_seq=10).flagged == ()
    assert missing(setting) == 2


def test_a_late_row_far_off_the_numbers_of_its_source_counts_no_gap(setting):
    for first_seq, seq in ((0, 5_000_000_000), (5_000_000_000, 3)):
        source = f"sa-{seq}"
        setting.append([100, 101], [-1.0, -2.0], first_seq=first_seq, source=source)
        assert setting.append([50], -3.0, first_seq=seq, source=source).accepted == 1
        assert missing(setting, source) == 0


def test_a_jump_of_just_a_thousand_million_numbers_is_a_gap(setting):
    send(setting, range(1))
    assert setting.append([500], -3.0, first_seq=1_000_000_000).flagged == ()
    assert missing(setting) == 999_999_999
