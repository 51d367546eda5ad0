"""Every carrier plan can be swept: powers read from the trace are those of the export."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument_settings import reset_state
from analyzer_sim.instrument.models import FSW_26
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.instrument.quantities import store
from analyzer_sim.instrument.spectrum import ENBW_PER_RBW
from analyzer_sim.world.ground.ground_bodies import task
from analyzer_sim.world.payload.user_noise import sweep_sigma_db
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

SEED = 3
ROWS = 30


def mean_power_dbm(world: World, rows: range, columns: list[int]) -> np.ndarray:
    """Sweep rows as the task says and return the mean integrated powers (columns,), noise subtracted."""
    sweep = task(world, world.plan_versions[-1].carriers)["sweeps"][0]
    settings = replace(reset_state(FSW_26), detector="RMS")
    for name in ("start_hz", "stop_hz", "rbw_hz", "points", "time_s"):
        store(settings, name, sweep[name])
    axis_hz = np.linspace(settings.start_hz, settings.stop_hz, settings.points)
    carriers = [world.plan.carriers[k] for k in columns]
    bands = np.array([np.abs(axis_hz - c.center_hz) <= 0.5 * c.bandwidth_hz + 30e3 for c in carriers])
    quiet = np.any([(axis_hz > low) & (axis_hz < high) for low, high in world.plan.noise_windows_hz], axis=0)
    painter = TracePainter(SEED, IDEAL)
    powers = []
    for row in rows:
        power_mw = 10.0 ** (painter.paint(world.emission(row), settings).level_dbm / 10.0)
        floor_mw = power_mw[quiet].mean()
        powers.append((power_mw - floor_mw) @ bands.T * (axis_hz[1] - axis_hz[0]) / (ENBW_PER_RBW * settings.rbw_hz))
    return 10.0 * np.log10(np.mean(powers, axis=0))


@pytest.mark.parametrize(
    "name", ["nominal", "few8", "many32", "dual_band", "stale_calibration", "flicker", "sun_outage", "beacons"]
)
def test_a_sweep_reads_the_powers_of_the_world(name: str) -> None:
    world = World(replace(scenario_named(name), quiet_h=1.0, operation_h=24.0), SEED)
    first = len(world.rows.epochs_us) - 600
    if name == "sun_outage":
        first = int(np.argmax(world.rows.sun_noise_db)) - ROWS // 2
    rows = range(first, first + ROWS)
    columns = np.flatnonzero(world.rows.is_on[first]).tolist()
    expected_mw = 10.0 ** (world.rows.power_dbm[rows.start : rows.stop, columns] / 10.0)
    error_db = mean_power_dbm(world, rows, columns) - 10.0 * np.log10(expected_mw.mean(axis=0))
    print(f"{name}: {len(columns)} carriers, error mean {error_db.mean():.3f}, largest {np.abs(error_db).max():.3f} dB")
    # thirty sweeps of some 0.1 dB each: 0.02 dB, four sigmas; half as much again for noise ten times up
    assert np.abs(error_db).max() < 6.0 * sweep_sigma_db(world.plan).max() / np.sqrt(ROWS)
