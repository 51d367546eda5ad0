"""Every storage keeps results once, in the sequence of their making, and tells a row for every consumed measurement."""

import math
from dataclasses import replace

import numpy as np
import pytest
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.ports import LIVE, Outcome
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import Method
from service.records.levels.attitude import Axes, Status
from service.records.levels.command import AppliedCommand

BOTH = (Method.ROBUST, Method.PAPER)
NAN = float("nan")


def reasons(setting, make, method):
    rows = setting.storage.results.attitude_rows(setting.id, LIVE, method, make.ever, 99, None)
    return [row.inhibitions for row in rows]


def outcomes(setting, make, methods=BOTH):
    return [Outcome(tuple(make.attitude_row(row, method) for method in methods), None) for row in setting.rows()]


FIGURES = ("attitude_deg", "sigma_deg", "rates_deg_s", "protection_deg")
SINGLES = ("downlink_fade_db", "common_db", "residual_rms_db", "lag_s")


@settings(
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    max_examples=examples(40),
)
@given(
    figures=st.lists(st.floats(), min_size=16, max_size=16),
    has_rates=st.booleans(),
    claims=st.lists(st.booleans(), min_size=5, max_size=5),
    status=st.sampled_from(Status),
)
def test_an_attitude_row_comes_back_bit_for_bit(new_setting, make, figures, has_rates, claims, status):
    setting = new_setting()
    setting.append([10])
    axes = {name: Axes(*figures[3 * k : 3 * k + 3]) for k, name in enumerate(FIGURES)}
    if not has_rates:
        axes["rates_deg_s"] = None
    row = make.attitude_row(
        setting.rows()[0],
        **axes,
        **dict(zip(SINGLES, figures[12:], strict=True)),
        status=status,
        control_allowed=claims[0],
        control_allowed_axes=tuple(claims[1:4]),
        downlink_fade=claims[4],
    )
    setting.consume([Outcome((row,), None)])
    stored = setting.storage.results.newest_attitude(setting.id, LIVE, Method.ROBUST)

    def bits(record):
        values = [value for name in FIGURES for value in getattr(record, name) or ()]
        values += [getattr(record, name) for name in SINGLES]
        return np.array([math.nan if math.isnan(value) else value for value in values]).tobytes()

    assert bits(stored) == bits(row)
    blank = dict.fromkeys((*FIGURES, *SINGLES))
    assert replace(stored, **blank) == replace(row, **blank)
    assert (stored.rates_deg_s is None) == (not has_rates)


def test_a_command_comes_back_equal(setting, make):
    setting.append([10])
    command = make.torque_command(setting.rows()[0], torque_n_m=Axes(-0.0, 1e-300, 0.1), wheels_n_m=(0.1 + 0.2, -0.0))
    setting.consume([Outcome((), command)])
    stored = setting.storage.results.newest_command(setting.id, LIVE)
    assert stored == command
    # equality does not see the sign of zero
    assert math.copysign(1.0, stored.torque_n_m.yaw) == math.copysign(1.0, stored.wheels_n_m[1]) == -1.0


def test_a_row_stored_once_stays_as_it_is(setting, make):
    setting.append([10])
    (measured,) = setting.rows()
    first, second = make.attitude_row(measured), make.attitude_row(measured, common_db=9.0)
    assert setting.consume([Outcome((first, first), None)]) == 1
    assert setting.consume([Outcome((second,), None)]) == 1
    assert setting.storage.results.newest_attitude(setting.id, LIVE, Method.ROBUST) == first


def test_sequences_follow_the_order_of_making_without_gaps(setting, make):
    results = setting.storage.results
    setting.append([10, 20])
    first, second = setting.rows()
    command = make.torque_command(first)
    rows = [make.attitude_row(first, method) for method in BOTH]
    assert setting.consume([Outcome(tuple(rows), command)]) == 3
    later = make.attitude_row(second)
    assert setting.consume([Outcome((rows[0], later), command)]) == 4
    assert results.results_after(setting.id, 0, 99) == [(1, rows[0]), (2, rows[1]), (3, command), (4, later)]
    assert results.results_after(setting.id, 1, 2) == [(2, rows[1]), (3, command)]
    assert results.results_after(setting.id, 4, 99) == []
    assert setting.storage.archive.head(setting.id).result_sequence == 4


def test_only_the_live_version_counts_and_moves_the_head(setting, make):
    setting.append([10])
    (measured,) = setting.rows()
    command = make.torque_command(measured)
    replayed = Outcome((make.attitude_row(measured),), command, AppliedCommand(command))
    assert setting.consume([replayed], "replay-1") == 0
    assert setting.consume([replayed], "replay-1") == 0
    head = setting.storage.archive.head(setting.id)
    assert (head.newest_number, head.consumed_number, head.result_sequence) == (4, 0, 0)
    results = setting.storage.results
    assert results.attitude_rows(setting.id, "replay-1", Method.ROBUST, make.ever, 9, None) == [replayed.rows[0]]
    assert results.newest_attitude(setting.id, "replay-1", Method.ROBUST) == replayed.rows[0]
    assert results.newest_attitude(setting.id, "replay-1", Method.PAPER) is None
    assert results.commands(setting.id, "replay-1", make.ever, 9, None) == [command]
    assert results.newest_attitude(setting.id, LIVE, Method.ROBUST) is None
    assert results.newest_command(setting.id, LIVE) is None
    assert results.results_after(setting.id, 0, 9) == []


def test_an_applied_command_enters_the_journal_once(setting, make):
    setting.append([10])
    command = make.torque_command(setting.rows()[0])
    applied = Outcome((), command, AppliedCommand(command))
    setting.consume([applied])
    setting.consume([applied])
    entries = setting.storage.archive.journal(setting.id, 4, 99)
    assert [(entry.number, entry.content) for entry in entries] == [(5, AppliedCommand(command))]


def test_the_head_never_moves_back(setting):
    setting.append([10, 20])
    setting.consume()
    setting.storage.results.save_outcomes(setting.id, LIVE, [], 2, 5)
    setting.storage.results.save_outcomes(setting.id, LIVE, [], 3, None)
    head = setting.storage.archive.head(setting.id)
    assert (head.consumed_number, head.consumed_epoch_us) == (5, 20)


def test_rows_that_were_not_computed_tell_why(setting, make):
    """Numbers: 4 row, 5 paper activation, 6 row, 7 geometry activation, 8 row, 9 alignment, 10 row."""
    setting.append([10])
    setting.calibrate(CalibrationMethod.PAPER)
    setting.append([20])
    setting.calibrate(CalibrationMethod.GEOMETRY)
    setting.append([30])
    setting.align(25)
    setting.append([40])
    setting.consume()
    assert reasons(setting, make, Method.ROBUST) == [("no_calibration",)] * 2 + [("not_aligned",)] * 2
    assert reasons(setting, make, Method.PAPER) == [("no_calibration",)] + [("not_aligned",)] * 3
    row = setting.storage.results.newest_attitude(setting.id, LIVE, Method.ROBUST)
    assert (row.epoch_us, row.number, row.received_at_us, row.status) == (40, 10, 77, Status.INVALID)
    assert all(math.isnan(angle) for angle in (*row.attitude_deg, *row.sigma_deg))
    assert (row.control_allowed, row.carriers_used, row.calibration_id, row.alignment_id) == (False, 0, None, None)


def test_a_geometry_calibration_serves_the_paper_method_too(setting, make):
    setting.calibrate(CalibrationMethod.GEOMETRY)
    setting.append([10])
    setting.consume()
    assert reasons(setting, make, Method.PAPER) == [("not_aligned",)]


def test_there_is_one_row_a_consumed_measurement_of_the_prime_source(setting, make):
    results = setting.storage.results
    setting.append([30, 10, 20])
    setting.append([15], source="sa-2")
    computed = [make.attitude_row(row) for row in setting.rows() if row.epoch_us == 20]
    setting.consume([Outcome(tuple(computed), None)])
    setting.append([40])
    rows = results.attitude_rows(setting.id, LIVE, Method.ROBUST, make.ever, 99, None)
    assert [(row.epoch_us, row.number, row.status) for row in rows] == [
        (10, 5, Status.INVALID),
        (20, 6, Status.ACQUIRED),
        (30, 4, Status.INVALID),
    ]
    # repr, because NaN is not equal to itself
    assert repr(results.newest_attitude(setting.id, LIVE, Method.ROBUST)) == repr(rows[-1])


def test_the_newest_row_takes_one_statement_and_is_the_last_of_the_history(setting, make, monkeypatch):
    setting.append([10, 20, 30])
    setting.consume(outcomes(setting, make))
    results = setting.storage.results
    last = results.attitude_rows(setting.id, LIVE, Method.ROBUST, make.ever, 99, None)[-1]
    with monkeypatch.context() as patch:
        patch.setattr("db.results.results.AttitudeReader", None)
        assert results.newest_attitude(setting.id, LIVE, Method.ROBUST) == last
    # the row of a newer measurement was not computed: the search finds it
    setting.append([40])
    setting.consume([])
    assert results.newest_attitude(setting.id, LIVE, Method.ROBUST).epoch_us == 40


@pytest.mark.parametrize("version", [LIVE, "replay-1"])
def test_pages_of_attitude_and_commands_join(setting, make, version):
    results = setting.storage.results
    setting.append([30, 10, 20, 40])
    made = [Outcome((make.attitude_row(row),), make.torque_command(row)) for row in setting.rows()]
    setting.consume(made, version)
    rows, commands, after = [], [], None
    while page := results.attitude_rows(setting.id, version, Method.ROBUST, Window(10, 40), 2, after):
        rows += page
        after = (page[-1].epoch_us, page[-1].number)
    after = None
    while page := results.commands(setting.id, version, Window(10, 40), 2, after):
        commands += page
        after = (page[-1].epoch_us, page[-1].number)
    assert [row.epoch_us for row in rows] == [command.epoch_us for command in commands] == [10, 20, 30]
    assert results.newest_command(setting.id, version).epoch_us == 40


def test_pending_counts_rows_after_the_alignment_without_a_result_of_every_method(setting, make):
    def pending(*methods):
        return setting.storage.results.pending(setting.id, methods)

    setting.append([10, 20, 30])
    setting.append([35], source="sa-2")
    assert pending(*BOTH) == 0
    setting.calibrate()
    setting.align(10)
    assert pending(*BOTH) == pending(Method.ROBUST) == 2
    assert pending() == 0
    rows = outcomes(setting, make, (Method.ROBUST,))
    setting.consume(rows[1:2])
    assert (pending(Method.ROBUST), pending(Method.PAPER), pending(*BOTH)) == (1, 2, 2)
    setting.consume(outcomes(setting, make))
    assert pending(*BOTH) == 0
    setting.append([15, 40])
    assert pending(*BOTH) == 2
    setting.consume(outcomes(setting, make))
    assert pending(*BOTH) == 0
    setting.align(5)
    setting.append([6, 4])
    assert pending(*BOTH) == 1


def test_rows_after_an_alignment_are_computed_by_it_or_stay(setting, make):
    def rows_after(alignment):
        by_method = {**alignment.calibration_by_method, Method.ROBUST.value: 1, Method.PAPER.value: 1}
        return setting.storage.results.rows_after(setting.id, replace(alignment, calibration_by_method=by_method))

    setting.append([10, 20, 30])
    setting.calibrate()
    first = setting.align(10)
    assert rows_after(first) == (2, 0)
    made = outcomes(setting, make)
    setting.consume([aligned(outcome, first.id) for outcome in made])
    # computed meanwhile, and told all the same
    assert rows_after(first) == (2, 0)
    again = setting.align(10)
    assert rows_after(again) == (0, 2)
    setting.append([25])
    later = setting.align(20)
    assert rows_after(later) == (1, 1)


def aligned(outcome, alignment_id):
    return replace(outcome, rows=tuple(replace(row, alignment_id=alignment_id) for row in outcome.rows))


def test_outcomes_of_a_long_catch_up_are_stored_once(setting, make):
    epochs_us = list(range(1, 701))
    setting.append(epochs_us)
    made = outcomes(setting, make)
    assert setting.consume(made[:300]) == 600
    assert setting.consume(made) == 1400
    numbers = [number for number, _ in setting.storage.results.results_after(setting.id, 0, 5000)]
    assert numbers == list(range(1, 1401))
