"""One cycle of sweeps becomes one row; what is not measured is NaN and says why."""

import json
from typing import Any

import numpy as np
import pytest

from service.core.radio.carrier_power import GAUSSIAN_ENBW_RATIO
from service.frontend.acquisition.evaluation import TaskEvaluation, level_offset_db
from service.frontend.measurement_task import InputPart, MeasurementTask, parse_task
from service.frontend.upload.plan_binding import PlanMismatchError, bind_plan
from service.records.levels.measurement import QualityFlag, Sweep, SweepSettings

ENBW_HZ = 30e3 * GAUSSIAN_ENBW_RATIO
SETTINGS = SweepSettings(950e6, 990e6, 4001, 30e3, ENBW_HZ, 300e3, 2.0, "RMS")
NOISE_MW_HZ = 1e-12


def task(**path: Any) -> MeasurementTask:
    """Return a task of three carriers in two sweeps of the same span."""
    noise = [[951e6, 954e6], [988e6, 989.5e6]]
    sweep = {"start_hz": 950e6, "stop_hz": 990e6, "rbw_hz": 30e3, "points": 4001, "time_s": 2.0}
    carrier = {"symbol_rate": 1e6, "integ_bw_hz": 1.25e6, "noise": noise}
    document = {
        "task": {"id": "t"},
        "input": path,
        "sweeps": [sweep | {"id": "a"}, sweep | {"id": "b"}],
        "carriers": [
            carrier | {"id": "c00", "sweep": "a", "fc_hz": 960e6},
            carrier | {"id": "c01", "sweep": "b", "fc_hz": 965e6},
            carrier | {"id": "c02", "sweep": "a", "fc_hz": 970e6},
        ],
    }
    return parse_task(json.dumps(document).encode())[0]


def sweep(sweep_id: str, levels_dbm: dict[float, float], epoch_us: int = 1000, **changes: Any) -> Sweep:
    """Return a sweep with flat carriers of one megahertz (centre MHz -> dBm) over a flat floor."""
    axis = np.linspace(950e6, 990e6, 4001)
    power = np.full(axis.size, NOISE_MW_HZ * ENBW_HZ)
    for centre_mhz, level_dbm in levels_dbm.items():
        inside = np.abs(axis - 1e6 * centre_mhz) < 0.5e6
        power += inside * 10 ** (level_dbm / 10) / inside.sum() * ENBW_HZ / 10e3
    return Sweep(sweep_id, epoch_us, SETTINGS, power, **changes)


def cycle(**changes: Any) -> dict[str, Sweep | None]:
    """Return both sweeps of a good cycle."""
    return {
        "a": sweep("a", {960.0: -45.0, 970.0: -50.0}, 1000, **changes),
        "b": sweep("b", {965.0: -48.0}, 2000),
    }


def test_levels_stand_in_the_order_of_the_task() -> None:
    row = TaskEvaluation(task()).row(cycle())
    # flat carriers lie wholly inside their band: only rounding of dB remains
    np.testing.assert_allclose(row.power_dbm, [-45.0, -48.0, -50.0], atol=1e-6)
    assert row.epoch_us == 1500
    assert row.flags.tolist() == [0, 0, 0]
    assert (row.sigma_db > 0).all()
    # over a floor of -120 dBm/Hz, whose rounding is that of dB
    np.testing.assert_allclose(row.c_n0_db_hz, [75.0, 72.0, 70.0], atol=1e-6)
    # a flat megahertz holds 99 % in 990 kHz, to a bucket of 10 kHz
    np.testing.assert_allclose(row.occupied_bandwidth_hz, 990e3, atol=10e3)
    np.testing.assert_allclose(row.centroid_offset_hz, 0.0, atol=1.0)


def test_an_offset_of_the_input_moves_no_centre() -> None:
    shifted = task(freq_offset_hz=0.4e6)
    sweeps = {"a": sweep("a", {960.42: -45.0, 970.4: -50.0}), "b": sweep("b", {965.4: -48.0})}
    row = TaskEvaluation(shifted).row(sweeps)
    # twenty kilohertz are two buckets
    np.testing.assert_allclose(row.centroid_offset_hz, [20e3, 0.0, 0.0], atol=1.0)


def test_an_absent_carrier_is_nan_with_a_flag_and_never_the_noise() -> None:
    sweeps = {"a": sweep("a", {960.0: -45.0}), "b": sweep("b", {})}
    row = TaskEvaluation(task()).row(sweeps)
    for values in (row.power_dbm, row.c_n0_db_hz, row.occupied_bandwidth_hz, row.centroid_offset_hz):
        assert np.isnan(values).tolist() == [False, True, True]
    assert row.flags.tolist() == [0, QualityFlag.NO_CARRIER, QualityFlag.NO_CARRIER]


def test_a_failed_sweep_leaves_the_other_carriers_good() -> None:
    row = TaskEvaluation(task()).row(cycle() | {"b": None})
    assert np.isnan(row.power_dbm).tolist() == [False, True, False]
    assert row.flags[0] == QualityFlag.PARTIAL_CYCLE
    assert row.flags[1] == QualityFlag.PARTIAL_CYCLE | QualityFlag.NOT_MEASURED


def test_a_stale_trace_is_no_measurement() -> None:
    evaluation = TaskEvaluation(task())
    assert np.isfinite(evaluation.row(cycle()).power_dbm).all()
    row = evaluation.row(cycle(is_stale=True))
    assert np.isnan(row.power_dbm).tolist() == [True, False, True]
    assert row.flags[0] & QualityFlag.STALE_TRACE
    assert np.isfinite(evaluation.row(cycle()).power_dbm).all()


@pytest.mark.parametrize(
    ("change", "flag"),
    [
        ("is_overrange", QualityFlag.OVERRANGE),
        ("is_uncalibrated", QualityFlag.UNCAL),
        ("is_reference_unlocked", QualityFlag.REFERENCE_UNLOCKED),
        ("is_setting_mismatch", QualityFlag.SETTING_MISMATCH),
    ],
)
def test_flags_of_the_sweep(change: str, flag: QualityFlag) -> None:
    row = TaskEvaluation(task()).row(cycle(**{change: True}), extra=QualityFlag.SIMULATED)
    assert row.flags.tolist() == [flag | 512, 512, flag | 512]
    assert np.isfinite(row.power_dbm).all()


def test_weak_and_displaced_carriers_are_flagged() -> None:
    level_of_c_n_2 = 10 * np.log10(NOISE_MW_HZ * 1e6) + 2.0
    sweeps = {"a": sweep("a", {960.0: level_of_c_n_2, 970.15: -50.0}), "b": sweep("b", {965.0: -48.0})}
    flags = TaskEvaluation(task()).row(sweeps).flags
    assert flags[0] == QualityFlag.LOW_C_N
    assert flags[2] == QualityFlag.FREQUENCY_OFFSET


def test_the_analyzers_own_noise_is_flagged_where_it_is_known() -> None:
    row = TaskEvaluation(task(danl_dbm_hz=-125.0)).row(cycle())
    assert row.flags.tolist() == [QualityFlag.DANL_LIMITED] * 3


def test_not_a_number_in_the_band() -> None:
    sweeps = cycle()
    damaged = sweeps["a"]
    assert damaged is not None
    damaged.power_mw[1000] = np.nan
    row = TaskEvaluation(task()).row(sweeps)
    assert np.isnan(row.power_dbm[0])
    assert row.flags[0] == QualityFlag.NONFINITE_VALUE


def test_a_strong_neighbour_is_flagged_on_the_weak_carrier_only() -> None:
    document = json.loads(task().model_dump_json())
    document["carriers"][2]["fc_hz"] = 961.25e6
    touching = parse_task(json.dumps(document).encode())[0]
    sweeps = {"a": sweep("a", {960.0: -25.0, 961.25: -60.0}), "b": sweep("b", {965.0: -48.0})}
    flags = TaskEvaluation(touching).row(sweeps).flags
    assert flags[2] & QualityFlag.NEIGHBOUR
    assert not flags[0] & QualityFlag.NEIGHBOUR


@pytest.mark.parametrize(("gap_rbw", "is_flagged"), [(1.9, True), (2.1, False)])
def test_a_neighbour_within_two_resolution_bandwidths_is_flagged_while_it_is_there(
    gap_rbw: float, is_flagged: bool
) -> None:
    document = json.loads(task().model_dump_json())
    centre_hz = 960e6 + 1.25e6 + gap_rbw * 30e3
    document["carriers"][2]["fc_hz"] = centre_hz
    evaluation = TaskEvaluation(parse_task(json.dumps(document).encode())[0])
    both = {"a": sweep("a", {960.0: -45.0, centre_hz / 1e6: -45.0}), "b": sweep("b", {965.0: -48.0})}
    flags = evaluation.row(both).flags
    assert [bool(flag & QualityFlag.NEIGHBOUR) for flag in flags] == [is_flagged, False, is_flagged]
    alone = {"a": sweep("a", {960.0: -45.0}), "b": sweep("b", {965.0: -48.0})}
    assert not evaluation.row(alone).flags[0] & QualityFlag.NEIGHBOUR


def test_level_offset_is_added_and_may_depend_on_frequency() -> None:
    row = TaskEvaluation(task(level_offset_db=3.5)).row(cycle())
    np.testing.assert_allclose(row.power_dbm, [-41.5, -44.5, -46.5], atol=1e-6)  # as above
    table = InputPart(level_offset_db=((970e6, 2.0), (960e6, 1.0)))
    np.testing.assert_allclose(level_offset_db(table, np.array([965e6])), [1.5], atol=1e-12)  # linear


def test_a_cycle_without_sweeps_gives_no_row() -> None:
    with pytest.raises(ValueError, match="without a sweep"):
        TaskEvaluation(task()).row({"a": None})


def test_rows_leave_in_the_order_of_the_plan() -> None:
    row = TaskEvaluation(task()).row(cycle())
    plan = {"plan_id": 7, "carriers": [{"id": "c02"}, {"id": "x"}, {"id": "c00"}]}
    binding = bind_plan(plan, ["c00", "c01", "c02"])
    body = binding.as_json(row)
    assert body["power_dbm"] == [pytest.approx(-50.0, abs=1e-5), None, pytest.approx(-45.0, abs=1e-5)]  # five decimals
    assert body["flags"] == [0, QualityFlag.NOT_MEASURED, 0]
    assert body["epoch"] == "1970-01-01T00:00:00.001500Z"
    assert (binding.unknown, binding.unmeasured) == (("c01",), ("x",))


@pytest.mark.parametrize("plan", [{}, {"plan_id": None, "carriers": []}, {"plan_id": 1, "carriers": [{"id": "y"}]}])
def test_a_plan_that_does_not_fit_is_refused(plan: dict[str, Any]) -> None:
    with pytest.raises(PlanMismatchError):
        bind_plan(plan, ["c00"])
