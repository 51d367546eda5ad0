"""Rows as arrays: blocks of any length, the plain and the compiled filter, rows whose numbers are lost."""

from itertools import pairwise

import filter_models
import numpy as np
import pytest
from example_counts import examples
from filter_models import bits, copied
from hypothesis import given, settings
from hypothesis import strategies as st

from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.filter_model import ATTITUDE, FilterSettings, core_size, pattern_change
from service.core.estimation.filtering.filter_state import FilterState, start
from service.core.estimation.filtering.plant import filter_model, torque_covariance
from service.core.estimation.filtering.row import take_rows
from service.core.estimation.filtering.row_block import (
    LOST,
    OLD,
    TAKEN,
    BlockResult,
    RowBlock,
    empty_block,
    empty_result,
    empty_trace,
    nothing_declared,
    write_declared,
)
from service.core.estimation.filtering.state_changes import inserted

MINUTE_US, CARRIERS, ROWS = 60_000_000, 12, 150
PUSHED = FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2), unknown_torque_deg_h2=(0.2, 0.2, 0.4))


class Story:
    """A filter at its alignment and rows in which most of what it can find happens."""

    def __init__(self, carriers=CARRIERS, rows=ROWS, *, shares=1, components=2, common=1, seed=11):
        self.carriers = filter_models.carrier_model(carriers, components=components, common=common)
        self.model = filter_model(self.carriers, PUSHED)
        gaussian, hidden = filter_models.aligned(self.carriers), core_size(self.carriers)
        torque = torque_covariance(PUSHED)
        prior = np.block([[np.eye(shares), np.zeros((shares, 9))], [np.zeros((9, shares)), torque]])
        self.state = start(self.carriers, 0, inserted(gaussian, hidden, prior))
        self.block = empty_block(rows, carriers, shares)
        self.fill(np.random.default_rng(seed))

    def fill(self, rng):
        rows, carriers, model = self.block.rows, self.block.carriers, self.carriers
        steps_us = rng.choice([10_000_000, MINUTE_US, MINUTE_US, MINUTE_US, 5 * MINUTE_US], len(rows))
        rows["epoch_us"] = np.cumsum(steps_us)
        level_db = carriers["deviation_db"]
        level_db[:] = model.white_sigma_db * rng.standard_normal(level_db.shape)
        level_db[20:45] -= 3.0 * model.rain_share
        level_db[50:, 1 % level_db.shape[1]] += 1.5
        level_db[10:11, :3] += np.array([-9.0, 6.0, -5.0])[: level_db.shape[1]]
        level_db[60:, :] += np.where(model.transponder == 2, -1.5, 0.0)
        level_db[70:, :] += pattern_change(model, np.array([0.0, 0.4, -0.4])).deviation_db
        level_db[rng.random(level_db.shape) < 0.05] = np.nan
        level_db[80:83] = np.nan
        carriers["reported_wet"][30:, ::2], carriers["reported_wet"][30:, 1::2] = 1.0, 0.0
        rows["correction_deg"][90:120, 1] = 0.005
        rows["late_correction_deg"][125:126, 2] = 0.02
        rows["rate_change_deg_h"][130:135, 1] = 0.01
        self.block.unreported[:] = 0.01 * rng.standard_normal(self.block.unreported.shape)
        declared = nothing_declared(len(self.state.carriers), 3)
        masked = np.arange(len(self.state.carriers)) == 3
        for number in range(min(100, len(rows)), min(110, len(rows))):
            write_declared(self.model, self.block, number, declared._replace(is_masked=masked, chain_walk_db=0.1))
        for number in range(min(112, len(rows)), min(113, len(rows))):
            groups = np.array([0.0, 0.5, 0.0])
            write_declared(self.model, self.block, number, declared._replace(chain_step_db=1.0, group_step_db=groups))
        # one row comes late and one twice
        rows["epoch_us"][min(40, len(rows)) - 1] = 1
        rows["epoch_us"][41:42] = rows["epoch_us"][42:43]


def part(block: RowBlock, first: int, stop: int) -> RowBlock:
    return RowBlock(*(each[first:stop] for each in block))


def taken(model, state, block) -> tuple[FilterState, BlockResult]:
    result = empty_result(len(block.rows), len(model.carriers))
    return advance(model, state, block, result), result


def taken_one_by_one(model, state, block) -> tuple[FilterState, BlockResult]:
    rows = []
    for number in range(len(block.rows)):
        state, result = taken(model, state, part(block, number, number + 1))
        rows.append(result)
    return state, BlockResult(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def plainly_taken(model, state, block) -> tuple[FilterState, BlockResult]:
    """Return the same as plain Python."""
    result, one, other = empty_result(len(block.rows), len(model.carriers)), copied(state), copied(state)
    newest = take_rows(model, state, one, other, block, result, empty_trace(0, 0, 0))
    return (state, one, other)[newest], result


@pytest.fixture(scope="module")
def story():
    return Story()


@pytest.fixture(scope="module")
def whole(story):
    return taken(story.model, story.state, story.block)


def test_the_story_tells_of_every_kind_of_event(whole):
    state, result = whole
    assert {*result.rows["cause"]} == {0, 1, 2, 3, 4}
    assert {*result.rows["status"]} == {TAKEN, OLD}
    assert result.rows["is_raining"].any()
    assert result.rows["reasons"].any()
    assert 0 < np.count_nonzero(result.rows["has_event"]) < len(result.rows)
    assert state.carriers["is_flagged"].any() or state.carriers["is_relearned"].any()


def test_a_state_given_is_never_changed(story):
    before = bits(story.state)
    taken(story.model, story.state, story.block)
    assert bits(story.state) == before


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_plain_python_gives_what_the_compiled_filter_gives(story, whole):
    state, result = plainly_taken(story.model, story.state, story.block)
    assert_alike(result.rows, whole[1].rows)
    assert_alike(result.carriers, whole[1].carriers)
    for one, other in zip(state, whole[0], strict=True):
        assert_alike(one, other)


def assert_alike(one, other):
    """Compare arrays of numbers or records; products of another library add in another order, over many rows."""
    for name in one.dtype.names or (...,):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-9, atol=1e-12, err_msg=str(name))


def test_rows_one_by_one_give_the_same_bits_as_a_block(story, whole):
    state, result = taken_one_by_one(story.model, story.state, story.block)
    assert bits(state) == bits(whole[0])
    assert bits(result) == bits(whole[1])


@settings(derandomize=True, deadline=None, max_examples=examples(30))
@given(st.sets(st.integers(0, ROWS), max_size=12), st.integers(0, 2))
def test_a_block_cut_anywhere_gives_the_same_bits(story, cuts, shares):
    told = story if shares == 1 else Story(rows=ROWS, shares=shares)
    whole, result = taken(told.model, told.state, told.block)
    state, parts, edges = told.state, [], [0, *sorted(cuts), ROWS]
    for first, stop in pairwise(edges):
        state, found = taken(told.model, state, part(told.block, first, stop))
        parts.append(found)
    assert bits(state) == bits(whole)
    assert bits(BlockResult(*(np.concatenate(each) for each in zip(*parts, strict=True)))) == bits(result)


def test_a_restored_state_goes_on_with_the_same_bits(story, whole):
    """Nobody may write to the arrays of a state that was read, and they may be cut out of others."""
    state, _ = taken(story.model, story.state, part(story.block, 0, 65))
    read = FilterState._make(np.asfortranarray(each) for each in copied(state))
    for each in read:
        each.setflags(write=False)
    assert bits(taken(story.model, read, part(story.block, 65, ROWS))[0]) == bits(whole[0])


def test_a_covariance_stays_symmetric_to_the_bit_and_positive(whole):
    covariance = whole[0].covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    scale = np.sqrt(np.diagonal(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 1e-9


def test_no_row_leaves_the_state_as_it_is(story):
    state, result = taken(story.model, story.state, part(story.block, 0, 0))
    assert state is story.state
    assert len(result.rows) == 0


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_few_rows_are_taken_as_they_come(story, rows):
    state, result = taken(story.model, story.state, part(story.block, 0, rows))
    assert {*result.rows["status"]} == {TAKEN}
    assert state.epoch_us == story.block.rows["epoch_us"][rows - 1]
    np.testing.assert_array_equal(result.rows["attitude_deg"][-1], state.mean[ATTITUDE])


@pytest.mark.parametrize(("carriers", "rows"), [(1, 30), (3, 30), (128, 12)])
def test_one_carrier_and_as_many_as_there_are_leave_a_sound_state(carriers, rows):
    told = Story(carriers, rows, shares=0)
    state, result = taken(told.model, told.state, told.block)
    assert np.isfinite(state.mean).all()
    assert (np.diagonal(state.covariance) > 0.0).all()
    # with fewer than four carriers the filter coasts
    assert result.carriers["is_used"].any() == (carriers >= 4)
    assert bits(taken_one_by_one(told.model, told.state, told.block)[0]) == bits(state)


def test_a_block_of_events_alone_is_taken_as_its_rows_are(story):
    block = empty_block(40, CARRIERS, 1)
    block.rows["epoch_us"] = MINUTE_US * np.arange(1, 41)
    # all levels rise and fall by three decibels in every row
    block.carriers["deviation_db"] = 3.0 * (-1.0) ** np.arange(40)[:, None]
    state, result = taken(story.model, story.state, block)
    assert result.rows["has_event"].all()
    assert {*result.rows["status"]} == {TAKEN}
    assert bits(taken_one_by_one(story.model, story.state, block)[0]) == bits(state)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("correction_deg", np.nan),
        ("correction_deg", 1e110),
        ("rate_change_deg_h", np.inf),
        ("attitude_step_deg", 1e160),
    ],
)
@pytest.mark.parametrize("number", [0, 7, 29])
def test_a_row_whose_numbers_are_lost_leaves_the_state_and_the_rows_go_on(story, name, value, number):
    block = RowBlock(*(each.copy() for each in part(story.block, 0, 30)))
    block.rows[name][number], block.rows["is_declared"][number] = value, True
    state, result = taken(story.model, story.state, block)
    without = RowBlock(*(np.delete(each, number, axis=0) for each in block[:3]), block.records)
    expected, others = taken(story.model, story.state, without)
    assert result.rows["status"][number] == LOST
    assert {*np.delete(result.rows["status"], number)} == {TAKEN}
    assert bits(state) == bits(expected)
    np.testing.assert_array_equal(np.delete(result.rows["attitude_deg"], number, axis=0), others.rows["attitude_deg"])


@pytest.mark.parametrize("place", [0, 9, 30])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_state_whose_numbers_are_lost_stays_as_it_is(story, place, value):
    """The compiler's inverse raises where a matrix holds no numbers; a block of rows would end in it."""
    lost = copied(story.state)
    lost.covariance[place, :] = lost.covariance[:, place] = value
    state, result = taken(story.model, lost, part(story.block, 0, 3))
    assert {*result.rows["status"]} == {LOST}
    assert state is lost


def test_a_gap_of_months_under_a_torque_loses_no_numbers():
    told = Story(rows=3, shares=0)
    told.block.rows["epoch_us"] += 100 * 86_400_000_000
    state, result = taken(told.model, told.state, told.block)
    assert result.rows["status"][0] == TAKEN
    assert np.isfinite(state.mean).all()


def test_levels_beyond_all_measure_are_skipped(story):
    block = RowBlock(*(each.copy() for each in part(story.block, 0, 10)))
    block.carriers["deviation_db"][4] = 1e200
    state, result = taken(story.model, story.state, block)
    assert {*result.rows["status"]} == {TAKEN}
    assert not result.carriers["is_used"][4].any()
    assert np.abs(state.mean[ATTITUDE]).max() < 0.2


@pytest.mark.parametrize("shares", [0, 2])
def test_other_shares_than_there_are_commands_are_refused(story, shares):
    block = empty_block(1, CARRIERS, shares)
    with pytest.raises(ValueError, match=f"{shares} commands are unreported, which does not fit 10 hidden states"):
        taken(story.model, story.state, block)


def test_a_level_without_end_is_an_absent_one(story):
    block, absent = (RowBlock(*(each.copy() for each in part(story.block, 0, 10))) for _ in range(2))
    block.carriers["deviation_db"][4, 2], block.carriers["deviation_db"][5, 3] = np.inf, -np.inf
    absent.carriers["deviation_db"][4, 2] = absent.carriers["deviation_db"][5, 3] = np.nan
    state, result = taken(story.model, story.state, block)
    assert bits(state) == bits(taken(story.model, story.state, absent)[0])
    assert {*result.rows["status"]} == {TAKEN}
