"""Days that are sealed, summarised, and met by late rows while they are read: every answer is that of some moment."""

import threading

import numpy as np

from db.encoding.segments import DAY_US
from service.core.rows.sample_bins import SampleBins
from service.ports import LIVE, Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import Axes
from service.records.levels.carrier_results import CarrierResults

ALWAYS = 1 << 60
STEP_US = DAY_US // 50
SPAN = Window(0, 2 * DAY_US)
LATE = 60


def results_of(make, row):
    """Return the results of a row: all its values are its epoch, s."""
    value = row.epoch_us / 1e6
    levels_db = np.full((2, 3), (row.epoch_us // 1000) % 100 * 0.004)
    carriers = CarrierResults(row.plan_id, *levels_db, *np.zeros((2, 3), dtype=np.int64))
    return Outcome((make.attitude_row(row, attitude_deg=Axes(value, value, value)),), None, carriers=(carriers,))


def counts(setting):
    """Return how many rows samples and rows of each kind count, in the order in which they are stored."""
    results = setting.storage.results
    angles, levels, powers = (SampleBins(SPAN.start_us, SPAN.stop_us, 7, 3) for _ in range(3))
    for buckets in results.sampled_carriers(setting.id, LIVE, Method.ROBUST, SPAN, levels):
        levels.add_summaries(buckets.buckets.columns(slice(3)))
    for buckets in results.sampled_attitude(setting.id, LIVE, Method.ROBUST, SPAN, angles):
        angles.add_summaries(buckets)
    for sampled in setting.storage.archive.sampled_measurements(setting.id, SPAN, powers):
        powers.add_summaries(sampled.buckets)
    samples = angles.all_intervals()
    is_filled = samples.counts > 0
    # of each row the value is its epoch: a row that is counted twice, or with another one's value, changes these
    np.testing.assert_array_equal(samples.maxima[is_filled], samples.maximum_us[is_filled] / 1e6)
    np.testing.assert_array_equal(samples.minima[is_filled], samples.minimum_us[is_filled] / 1e6)
    return [int(bins.all_intervals().counts[:, 0].sum()) for bins in (levels, angles, powers)]


def test_samples_are_those_of_a_moment(setting, make):
    epochs_us = [k * STEP_US + 7 for k in range(130)]
    setting.append(epochs_us, -50.0)
    setting.consume([results_of(make, row) for row in setting.rows()])
    known = sum(epoch_us < SPAN.stop_us for epoch_us in epochs_us)
    stored, is_over, faults = [known], threading.Event(), []

    def run(work):
        def guarded():
            try:
                while not is_over.is_set():
                    work()
            except BaseException as fault:
                faults.append(fault)
                raise

        return threading.Thread(target=guarded)

    def seal():
        list(setting.storage.archive.seal(setting.id, ALWAYS, ALWAYS))
        list(setting.storage.results.seal(setting.id, ALWAYS))
        list(setting.storage.results.complete_summaries(setting.id, ALWAYS))

    def late():
        k = len(stored)
        epoch_us = k * (SPAN.stop_us // (LATE + 2)) + 11
        setting.append([epoch_us], -50.0)
        (row,) = setting.storage.archive.measurements(setting.id, Window(epoch_us, epoch_us + 1), 9, None)
        setting.consume([results_of(make, row)])
        stored.append(known + k)
        if k == LATE:
            is_over.set()

    def read():
        before = stored[-1]
        found = counts(setting)
        # what was stored when it began, and at most what was stored when it ended, the row under way among it
        assert all(before <= count <= stored[-1] + 1 for count in found), (before, found, stored[-1])

    threads = [run(work) for work in (seal, late, read, read)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300)
    assert faults == []
    assert counts(setting) == [known + LATE] * 3
    seal()
    assert counts(setting) == [known + LATE] * 3
