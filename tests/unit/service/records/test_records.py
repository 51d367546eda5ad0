"""Records: natural keys, small facts, and that nothing can be changed."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from service.records.catalogue import Carrier, Method
from service.records.inputs import (
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    Correction,
    EphemerisChange,
    Operation,
    PlanChange,
    PolarizationRecord,
    SourceSelection,
    SpacecraftChange,
    TelemetryRecord,
    WeatherReport,
)
from service.records.journal import KIND_OF, KINDS
from service.records.levels.attitude import Axes, Status, row_without_attitude
from service.records.levels.command import AppliedCommand, TorqueCommand
from service.records.levels.quality_flag import QualityFlag
from service.records.levels.sweep import Sweep, SweepSettings
from service.records.operations.job import Replay

ZERO = Axes(0.0, 0.0, 0.0)


def command(number):
    return TorqueCommand(
        1,
        number,
        1,
        "ground",
        ZERO,
        (),
        False,
        60.0,
        2,
        (),
        ZERO,
        ZERO,
        ZERO,
        (),
        True,
        (),
    )


@pytest.mark.parametrize(
    ("record", "key"),
    [
        (AttitudeReference("earth_sensor", 17, ZERO, ZERO), "earth_sensor/17"),
        (Correction(3, 9, ZERO), "3/9"),
        (TelemetryRecord(5), "5"),
        (WeatherReport("radar", "Kyiv", 5, 1.0), "radar/Kyiv/5"),
        (PolarizationRecord("p", 5, -15.0), "p/5"),
        (Operation(4, "other", 1, None, revision=2), "4/2"),
        (PlanChange(6), "6"),
        (EphemerisChange(7), "7"),
        (CalibrationActivation(1, 3), "3"),
        (AlignmentSet(8), "8"),
        (SourceSelection("sa-2", 2), "2"),
        (AppliedCommand(command(31)), "31"),
    ],
)
def test_inputs_know_their_natural_key(record, key):
    assert record.key == key
    assert KINDS[KIND_OF[type(record)]] is type(record)


def test_a_change_of_the_spacecraft_is_known_by_its_count(payload):
    assert SpacecraftChange(payload.spacecraft(), 12).key == "12"


@pytest.mark.parametrize(
    ("changes", "is_usable"),
    [
        ({}, True),
        ({"enabled": False}, False),
        ({"kind": "beacon"}, False),
        ({"kind": "pilot"}, True),
        ({"uplink_power_control": "auto"}, False),
    ],
)
def test_which_carriers_may_tell_the_attitude(changes, is_usable):
    assert replace(Carrier("c", "Ku", "t", 1.0, 1.0), **changes).is_usable_for_attitude == is_usable


def test_a_replay_is_a_version_of_its_own():
    assert Replay(12, 0, 1, None, None, 1, "journal", "job", 0).version == "replay-12"


def test_a_row_without_attitude_knows_nothing_and_allows_nothing():
    row = row_without_attitude(5, 6, 7, Method.PAPER, ("not_aligned",))
    assert np.isnan([*row.attitude_deg, *row.sigma_deg, row.common_db, row.residual_rms_db]).all()
    assert (row.status, row.control_allowed, row.control_allowed_axes) == (Status.INVALID, False, (False,) * 3)
    assert (row.rates_deg_s, row.calibration_id, row.alignment_id) == (None, None, None)


def test_every_quality_flag_is_a_bit_of_its_own():
    bits = [flag.value for flag in QualityFlag]
    assert len(set(bits)) == len(QualityFlag.__members__)
    assert all(bit & (bit - 1) == 0 for bit in bits)


@pytest.mark.parametrize(("points", "step_hz"), [(1001, 1000.0), (1, 1e6)])
def test_the_step_of_a_sweep(points, step_hz):
    settings = SweepSettings(1e9, 1.001e9, points, 1e3, 1.06e3, 100.0, 0.5, "RMS")
    assert settings.step_hz == step_hz
    assert Sweep("a", 1, settings, np.zeros(points)).settings.count == 1


def test_records_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        Correction(3, 9, ZERO).start_us = 4
