"""The journal of a world: slow inputs before the first row that is not older, powers in the order of the plan."""

from dataclasses import replace

import numpy as np
import pytest

from service.pipeline.inputs.documents import JournalDocuments
from service.records.catalogue import Carrier
from service.records.inputs import Correction, PlanChange, SourceSelection
from service.records.levels.attitude import Axes
from service.study.estimation.flight.journal import measurements, slow_entries
from service.study.estimation.flight.world import GroundEvent


class Listener:
    """Writes down what a chain is taught."""

    def __init__(self):
        self.taught = []

    def update(self, content):
        self.taught.append(content)


def carriers(*names):
    return tuple(Carrier(name, "Ku", "Ku1", 11e9, 1e6) for name in names)


@pytest.fixture
def ground(toured_world):
    """Four columns, ten rows; the plan holds two carriers in another order."""
    world = toured_world.ground
    power_dbm = np.arange(40.0).reshape(10, 4)
    return replace(
        world,
        carriers=carriers("c2", "c0"),
        epochs_us=world.epochs_us[:10],
        power_dbm=power_dbm,
        source=np.array([0] * 5 + [1] * 5),
        source_names=("sa-1", "sa-2"),
    )


def reported(ground, *events):
    """Return what a chain hears of the ten rows: the rows and, of each slow input, how many rows came before it."""
    ground = replace(ground, events=events)
    documents, listener = JournalDocuments(), Listener()
    documents.add_plan(ground.carriers)
    entries = slow_entries(ground, documents)
    rows, before = [], []
    for row in measurements(listener, ground, documents, entries, np.arange(10)):
        before += [len(rows)] * (len(listener.taught) - len(before))
        rows.append(row)
    return rows, listener.taught, before


def test_powers_stand_in_the_order_of_the_plan(ground):
    rows, _, _ = reported(ground)
    assert rows[3].power_dbm.tolist() == [14.0, 12.0]
    assert [row.number for row in rows] == list(range(1, 11))


def test_an_input_comes_before_the_first_row_that_is_not_older(ground):
    corrections = [
        GroundEvent(int(ground.epochs_us[row]) + late_us, Correction(1, 2, Axes(0.0, 0.0, float(row))))
        for row, late_us in ((7, 0), (2, 1))
    ]
    _, taught, before = reported(ground, *corrections)
    # told in the order of time; what comes a microsecond after a row is heard before the next
    assert [(content.change_deg.pitch, count) for content, count in zip(taught, before, strict=True)] == [
        (2.0, 3),
        (7.0, 7),
    ]


def test_a_new_plan_gives_another_order_from_its_row_on(ground):
    rows, taught, _ = reported(ground, GroundEvent(int(ground.epochs_us[4]), carriers("c0", "c1", "c3")))
    assert taught == [PlanChange(2)]
    assert [row.plan_id for row in rows] == [1] * 4 + [2] * 6
    assert rows[4].power_dbm.tolist() == [16.0, 17.0, 19.0]


def test_only_the_prime_analyzer_feeds_the_estimator(ground):
    rows, _, _ = reported(ground)
    assert [row.feeds_estimator for row in rows] == [True] * 5 + [False] * 5
    rows, _, _ = reported(ground, GroundEvent(int(ground.epochs_us[6]), SourceSelection("sa-2", 1)))
    assert [row.feeds_estimator for row in rows] == [True] * 5 + [False] + [True] * 4
    assert rows[9].source == "sa-2"
