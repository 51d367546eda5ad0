"""The oracle of a flight: measured motion and filter."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.export import export_npz
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World as SimulatedWorld
from service.records.calibration import Window
from service.study.estimation.flight.motion_statistics import NOTHING_MEASURED
from service.study.estimation.flight.oracle.filter import oracle_series
from service.study.estimation.flight.world import TrueStatistics, read_world

ROWS, CARRIERS, BEFORE = 1500, 12, 60
DRIFT_DEG_H, DRIFT_TAU_S = np.array([0.04, 0.025, 0.025]), 28_800.0
WHITE_DB, PART_DB, PART_TAU_S, CHAIN_DB, CHAIN_TAU_S = 0.1, 0.08, 1200.0, 0.08, 43_200.0
#: one turn in a sidereal day, rad/min
EXCHANGE = 7.2921159e-5 * 60.0


def first_order(rng, shape, sigma, tau_s):
    keep = np.exp(-60.0 / tau_s)
    values = np.empty(shape)
    values[0] = sigma * rng.normal(size=shape[1:])
    for row in range(1, len(values)):
        values[row] = keep * values[row - 1] + sigma * np.sqrt(1.0 - keep**2) * rng.normal(size=shape[1:])
    return values


@pytest.fixture
def drifting_world(toured_world):
    """Make a day of drift without corrections whose powers follow the oracle's model exactly."""

    def make(seed):
        rng = np.random.default_rng(seed)
        drift = first_order(rng, (ROWS, 3), DRIFT_DEG_H, DRIFT_TAU_S)
        attitude = np.zeros((ROWS, 3))
        for row in range(1, ROWS):
            yaw, roll, pitch = attitude[row - 1]
            turned = np.array([yaw - EXCHANGE * roll, roll + EXCHANGE * yaw, pitch])
            attitude[row] = turned + drift[row - 1] / 60.0
        slopes = np.column_stack(
            [0.15 * rng.normal(size=CARRIERS), 1.4 * rng.normal(size=CARRIERS), 1.2 * rng.normal(size=CARRIERS)]
        )
        noise = WHITE_DB * rng.normal(size=(ROWS, CARRIERS)) + first_order(rng, (ROWS, CARRIERS), PART_DB, PART_TAU_S)
        noise += first_order(rng, (ROWS, 1), CHAIN_DB, CHAIN_TAU_S)
        level = attitude @ slopes.T - 60.0
        statistics = TrueStatistics(
            level,
            np.broadcast_to(slopes, (ROWS, CARRIERS, 3)),
            np.full(CARRIERS, WHITE_DB),
            np.zeros(CARRIERS),
            np.full((CARRIERS, 1), PART_DB),
            np.full((CARRIERS, 1), PART_TAU_S),
            np.array([CHAIN_DB]),
            np.array([CHAIN_TAU_S]),
            0.0,
            DRIFT_DEG_H,
            DRIFT_TAU_S,
            is_coupled=True,
            correction_scale_sigma=0.0,
        )
        nothing = np.zeros((ROWS, CARRIERS))
        truth = replace(
            toured_world.truth,
            attitude_deg=attitude,
            downlink_fade_db=np.zeros(ROWS),
            level_db=nothing,
            flags=nothing.astype(np.int64),
            stations=tuple(f"s{k}" for k in range(CARRIERS)),
            station_loss_db=nothing.copy(),
            statistics=statistics,
        )
        epochs_us = toured_world.ground.epochs_us[:ROWS]
        ground = replace(
            toured_world.ground,
            phases={"operation": Window(int(epochs_us[BEFORE]), int(epochs_us[-1]))},
            carrier_ids=tuple(f"c{k:02d}" for k in range(CARRIERS)),
            epochs_us=epochs_us,
            power_dbm=level + noise,
            is_measured=np.ones(ROWS, dtype=bool),
            source=np.zeros(ROWS, dtype=np.int64),
        )
        return toured_world._replace(ground=ground, truth=truth)

    return make


def errors(world, **changes):
    world = world._replace(truth=replace(world.truth, **changes))
    series = oracle_series(world, np.arange(BEFORE, ROWS))
    return series, series.estimate_deg - world.truth.attitude_deg[BEFORE:]


def test_it_is_honest_where_its_model_is_true(drifting_world):
    seeds = (1, 2, 3, 4, 5, 6)
    squares, variances = [], []
    for seed in seeds:
        series, error = errors(drifting_world(seed))
        squares.append(np.mean(error**2, axis=0))
        variances.append(np.mean(series.sigma_deg**2, axis=0))
    ratio = np.sqrt(np.mean(squares, axis=0) / np.mean(variances, axis=0))
    print(f"seeds {seeds}: rms/sigma yaw {ratio[0]:.2f} roll {ratio[1]:.2f} pitch {ratio[2]:.2f}")
    # some twenty independent errors an axis: one sigma of the ratio is 0.16
    np.testing.assert_allclose(ratio, 1.0, atol=0.35)


def test_faded_carriers_are_left_out_and_stepped_ones_for_an_hour(drifting_world):
    loss, level = np.zeros((ROWS, CARRIERS)), np.zeros((ROWS, CARRIERS))
    loss[300:400, 0] = 0.5
    loss[300:400, 1] = 0.05
    level[500:, 2] = 1.0
    series, _ = errors(drifting_world(1), station_loss_db=loss, level_db=level - loss)
    expected = np.zeros((ROWS, CARRIERS), dtype=bool)
    expected[300:400, 0] = expected[500:560, 2] = True
    np.testing.assert_array_equal(series.is_excluded, expected[BEFORE:])


def test_what_is_left_out_moves_nothing(drifting_world):
    world = drifting_world(1)
    loss = np.zeros((ROWS, CARRIERS))
    loss[300:400, :3] = 5.0
    _, clean = errors(world, station_loss_db=loss)
    faded = world._replace(ground=replace(world.ground, power_dbm=world.ground.power_dbm - loss))
    _, rained = errors(faded, station_loss_db=loss)
    np.testing.assert_array_equal(rained, clean)


def test_motion_that_nobody_told_widens_the_attitude_while_it_lasts(drifting_world):
    world = drifting_world(1)
    moved = world.truth.attitude_deg.copy()
    moved[600:, 1] += np.clip(np.arange(ROWS - 600) / 40.0, 0.0, 1.0) * 0.4
    plain, _ = errors(world)
    series, error = errors(world, attitude_deg=moved)
    at = 615 - BEFORE
    assert series.sigma_deg[at, 1] > 1.5 * plain.sigma_deg[at, 1]
    np.testing.assert_array_equal(series.sigma_deg[: 600 - BEFORE, 1], plain.sigma_deg[: 600 - BEFORE, 1])
    assert np.abs(error[:, 1]).max() < 0.15  # deg: a filter that kept its width would be off by most of 0.4


def test_rain_over_the_receiving_site_takes_only_what_is_common(drifting_world):
    world = drifting_world(1)
    fade = np.zeros(ROWS)
    fade[300:420] = 3.0
    rained = world._replace(ground=replace(world.ground, power_dbm=world.ground.power_dbm - fade[:, None]))
    series, error = errors(rained, downlink_fade_db=fade)
    assert not series.is_excluded.any()
    assert np.abs(error[:, 1:]).max() < 0.1  # deg: 3 dB taken for motion would be some degrees


def test_a_world_that_does_not_state_its_statistics_is_refused(toured_world):
    with pytest.raises(ValueError, match="without true statistics"):
        oracle_series(toured_world, np.arange(BEFORE, ROWS))


SEEDS = (1, 2, 3, 4)
#: most of yaw's sigma by powers alone that is left where motion is measured, after an hour
LEFT = {"wheels": 0.55, "wheels_unstated": 0.7, "wheels_hourly": 0.9, "rates": 0.45, "polarized": 0.6}


@pytest.fixture(scope="module")
def short_world(tmp_path_factory):
    """Make a world of a day and a half, of which the last half day is operation."""
    folder, made = tmp_path_factory.mktemp("worlds"), {}

    def make(scenario, seed):
        if (scenario, seed) not in made:
            path = folder / f"{scenario}-{seed}.npz"
            story = scenario_named(scenario, quiet_days=1.0, operation_days=0.5)
            export_npz(SimulatedWorld(story, seed), path)
            made[scenario, seed] = read_world(path)
        return made[scenario, seed]

    return make


def answered(world):
    """Return errors and sigma (T, 3) of the oracle after an hour of operation."""
    start_us = world.ground.phases["operation"].start_us
    rows = np.flatnonzero(world.ground.is_measured & (world.ground.epochs_us >= start_us))
    series = oracle_series(world, rows)
    return (series.estimate_deg - world.truth.attitude_deg[rows])[60:], series.sigma_deg[60:]


def without_measured_motion(world):
    statistics = replace(world.truth.statistics, motion=NOTHING_MEASURED)
    return world._replace(truth=replace(world.truth, statistics=statistics))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", LEFT)
def test_it_is_honest_with_the_statistics_of_what_is_measured(short_world, scenario):
    errors, sigmas = zip(*(answered(short_world(scenario, seed)) for seed in SEEDS), strict=True)
    ratio = np.sqrt(np.mean(np.square(errors), axis=(0, 1)) / np.mean(np.square(sigmas), axis=(0, 1)))
    print(f"{scenario}, seeds {SEEDS}: rms/sigma yaw {ratio[0]:.2f} roll {ratio[1]:.2f} pitch {ratio[2]:.2f}")
    # some eight independent errors of yaw, thirty of the others: one sigma of the ratio is 0.25 and 0.13
    np.testing.assert_array_less(np.abs(ratio - 1.0), (0.5, 0.3, 0.3))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", LEFT)
def test_measured_motion_narrows_yaw_and_widens_no_axis(short_world, scenario):
    world = short_world(scenario, SEEDS[0])
    (error, sigma), (error_by_powers, sigma_by_powers) = answered(world), answered(without_measured_motion(world))
    left = np.sqrt(np.mean(sigma**2, axis=0) / np.mean(sigma_by_powers**2, axis=0))
    print(f"{scenario}, seed {SEEDS[0]}: sigma over that by powers {left.round(2)}")
    print(f"rms {np.sqrt(np.mean(error**2, axis=0)).round(4)}, {np.sqrt(np.mean(error_by_powers**2, axis=0)).round(4)}")
    assert left[0] < LEFT[scenario]
    assert (sigma <= sigma_by_powers + 1e-9).all()
