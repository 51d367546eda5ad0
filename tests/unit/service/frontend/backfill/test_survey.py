"""A survey counts gaps, duplicates, empty cells and equal faults exactly, in bounded memory."""

import random
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.frontend.backfill import survey as module
from service.frontend.backfill.survey import MOST_SHOWN, Survey

START_US = 1_795_219_200_000_000
MINUTE_US = 60_000_000


def surveyed(epochs_us: list[int]) -> dict[str, Any]:
    """Return the survey of epochs with one level each."""
    survey = Survey(["c00", "c01"])
    for epoch_us in epochs_us:
        survey.add(epoch_us, [-60.0, None])
    return survey.as_document(START_US)


@given(st.integers(3, 300), st.integers(0, 2**32 - 1))
def test_gaps_and_duplicates_do_not_depend_on_the_order_of_the_rows(rows: int, seed: int) -> None:
    draw = random.Random(seed)
    minutes = sorted(draw.choices(range(rows * 2), k=rows))
    epochs_us = [START_US + MINUTE_US * minute for minute in minutes]
    ordered = surveyed(epochs_us)
    draw.shuffle(epochs_us)
    mixed = surveyed(epochs_us)
    assert {**mixed, "is_in_order": None} == {**ordered, "is_in_order": None}
    assert ordered["duplicate_epochs"] == rows - len(set(minutes))
    steps = [step for step in np.diff(minutes) if step]
    assert ordered["gaps"] == sum(step > 2.5 * np.median(steps) for step in steps)
    assert ordered["is_in_order"] == (len(set(minutes)) == rows)


def test_the_longest_gap_comes_first_with_its_ends() -> None:
    minutes = [*range(100), *range(110, 200), *range(400, 500)]
    found = surveyed([START_US + MINUTE_US * minute for minute in minutes])
    assert found["gaps"] == 2
    assert found["longest_gaps"][0] == {
        "start": "2026-11-21T03:19:00.000000Z",
        "stop": "2026-11-21T06:40:00.000000Z",
        "duration_s": 201 * 60.0,
    }
    assert found["usual_step_s"] == 60.0
    assert found["age_s"] == -499 * 60.0


def test_levels_and_empty_cells_of_each_carrier() -> None:
    survey = Survey(["c00", "c01"])
    for k, levels in enumerate(([-60.0, None], [-62.5, None], [None, None])):
        survey.add(START_US + k, levels)
    document = survey.as_document(START_US)
    assert document["levels"] == {
        "c00": {"least_dbm": -62.5, "greatest_dbm": -60.0, "empty": 1},
        "c01": {"least_dbm": None, "greatest_dbm": None, "empty": 3},
    }
    assert document["mean_dbm"] == -61.25


def test_equal_faults_are_one_group_and_every_row_is_counted() -> None:
    survey = Survey(["c00"])
    for line in range(6334):
        survey.faults.add("epoch without offset; state --tz", line, f"line {line}")
    for kind in range(100):
        survey.faults.add(f"kind {kind}", kind, "other")
    document = survey.as_document(START_US)
    assert document["unreadable"] == 6434
    assert len(document["faults"]) == MOST_SHOWN
    assert document["faults"][0] == {
        "line": 0,
        "rows": 6334,
        "kind": "epoch without offset; state --tz",
        "detail": "line 0",
    }


def test_epochs_beyond_the_bound_are_counted_but_not_kept(monkeypatch: Any) -> None:
    monkeypatch.setattr(module, "MOST_EPOCHS", 10)
    found = surveyed([START_US + MINUTE_US * (k // 2) for k in range(40)])
    assert (found["rows"], found["duplicate_epochs"]) == (40, 5)
