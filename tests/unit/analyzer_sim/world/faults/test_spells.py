"""Storms, eclipses, the Sun, new plans and levels: what they do and what the ground is told."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from analyzer_sim.export import measured_dbm
from analyzer_sim.world.faults.spells import cooling
from analyzer_sim.world.faults.weather import wet_antenna_db
from analyzer_sim.world.payload.effects import FaultFlag
from analyzer_sim.world.payload.user_noise import sweep_sigma_db
from analyzer_sim.world.scenario.events import ChainStep, Eclipse, GroupStep, Relevel, Storm, SunOutage, SwitchOff
from analyzer_sim.world.scenario.scenario import Scenario, scenario_named
from analyzer_sim.world.world import World

SHORT = Scenario("short", "for tests", quiet_h=1.0, alignment_h=0.75, operation_h=12.0)
STORM = Storm("storm", 1, start_h=(2.0, 2.0), stations=(4, 4), wet_db=(1.5, 1.5))
ECLIPSE = Eclipse("night", (3.0, 3.0), (60.0, 60.0))


@cache
def built(*faults: object, seed: int = 1) -> World:
    return World(replace(SHORT, faults=faults), seed)


def hours(world: World) -> np.ndarray:
    return (world.rows.epochs_us - world.scenario.operation_start_us) / 3.6e9


def test_a_cell_takes_neighbouring_stations_one_after_another() -> None:
    world = built(STORM)
    fade = world.rows.uplink_fade_db
    hit = np.flatnonzero(fade.max(axis=0) > 0.0)
    assert len(hit) == 4
    order = np.argsort([carrier.station.longitude_deg for carrier in world.plan.carriers])
    positions = sorted(int(np.flatnonzero(order == carrier)[0]) for carrier in hit)
    assert positions == list(range(positions[0], positions[0] + 4))  # neighbours in longitude
    onsets_min = np.sort([60.0 * hours(world)[np.argmax(fade[:, carrier] > 0.0)] for carrier in hit])
    assert np.all((np.diff(onsets_min) >= 9.0) & (np.diff(onsets_min) <= 41.0))  # drawn from 10..40, rows of a minute


def test_a_wet_antenna_dries_over_an_hour() -> None:
    fade_db = np.zeros(200)
    fade_db[20:50] = 4.0
    wet_db = wet_antenna_db(fade_db, 1.5, 20.0, 1.0 / 60.0)
    assert wet_db[35] == pytest.approx(1.5)
    assert wet_db[49 + 60] == pytest.approx(1.5 * np.exp(-3.0), rel=1e-6)  # a twentieth is left after an hour
    assert not wet_db[:20].any()
    assert not wet_antenna_db(np.zeros(50), 1.5, 20.0, 1.0 / 60.0).any()


def test_wet_antennas_are_flagged_after_the_rain() -> None:
    rows = built(STORM).rows
    wet = (rows.flags & FaultFlag.WET_ANTENNA) != 0
    rain = (rows.flags & FaultFlag.UPLINK_RAIN) != 0
    assert wet.any()
    assert not np.any(wet & rain)
    assert np.all(rows.uplink_fade_db[wet] > 0.0)
    assert not rows.uplink_fade_db[~(wet | rain)].any()


def test_cooling_follows_its_time_constant_both_ways() -> None:
    share = cooling(np.array([0.9, 1.0 + 1.0 / 3.0, 2.0, 2.0 + 1.0 / 3.0, 9.0]), 1.0, 1.0, 1.0 / 3.0)
    full = 1.0 - np.exp(-3.0)
    np.testing.assert_allclose(share, [0.0, 1.0 - np.exp(-1.0), full, full * np.exp(-1.0), 0.0], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_an_eclipse_lowers_gains_and_bends_the_reflector(seed: int) -> None:
    world = built(ECLIPSE, seed=seed)
    end = int(np.searchsorted(hours(world), 4.0))
    fall_db = -world.rows.level_db[end] / (1.0 - np.exp(-3.0))
    for transponder in world.plan.beams:
        members = fall_db[[carrier.transponder == transponder for carrier in world.plan.carriers]]
        assert np.ptp(members) < 1e-9  # one gain, rounding
        assert 0.2 <= members[0] <= 0.5
    shift_deg = float(np.hypot(*world.rows.pattern_shift_deg[end])) / (1.0 - np.exp(-3.0))
    print(f"seed {seed}: gains fall by {np.unique(fall_db.round(2))} dB, reflector by {shift_deg:.3f} deg")
    assert 0.02 <= shift_deg <= 0.05
    assert np.all(np.abs(world.rows.level_db[end + 240]) < 1e-3)  # four hours later it is warm again


def test_a_bent_reflector_looks_like_an_attitude_but_leaves_it_alone() -> None:
    bent, straight = built(replace(ECLIPSE, gain_db=(0.0, 0.0))), built()
    end = int(np.searchsorted(hours(bent), 4.0))
    change_db = (bent.rows.carrier_dbm - straight.rows.carrier_dbm)[end]
    assert 0.01 < np.abs(change_db).max() < 0.25  # up to 0.05 deg on slopes of up to some 4 dB/deg
    assert bent.rows.attitude_deg.tobytes() == straight.rows.attitude_deg.tobytes()


def test_the_sun_raises_the_noise_and_spreads_what_is_measured() -> None:
    outage = SunOutage("sun", (2.0, 2.0), (15.0, 15.0), (10.0, 10.0))
    sunny, plain = built(outage), built()
    rise_db = sunny.rows.noise_dbm_hz - plain.rows.noise_dbm_hz
    assert rise_db.max() == pytest.approx(10.0, abs=0.1)  # the top lies between two rows
    assert 10 <= np.count_nonzero(rise_db > 0.0) <= 15  # minutes
    assert sunny.rows.power_dbm.tobytes() == plain.rows.power_dbm.tobytes()  # the carriers' own power does not change
    during = rise_db > 9.0
    spread = (measured_dbm(sunny) - sunny.rows.power_dbm)[during] / (measured_dbm(plain) - plain.rows.power_dbm)[during]
    assert np.all(spread > 1.03)  # the noise stands 12-22 dB under a carrier and comes 9-10 dB nearer
    assert np.all(spread < 1.6)


def test_new_levels_have_the_stated_spread() -> None:
    steps = np.concatenate([built(Relevel("new", 0.0), seed=seed).rows.level_db[-1] for seed in range(8)])
    assert float(steps.std()) == pytest.approx(0.5, rel=0.25)  # 128 draws: 6 %, four sigmas
    assert not built(Relevel("new", 0.0)).rows.level_db[:60].any()  # before it nothing


def test_declared_work_is_told_with_its_carriers() -> None:
    world = built(
        SwitchOff("off", ("c05", "c11"), (2.0, 2.0), (2.0, 2.0), is_announced=True),
        GroupStep("gain", "Ku2", (6.0, 6.0), is_announced=True),
        ChainStep("chain", (9.0, 9.0), is_announced=True),
    )
    found = [(o.kind, o.carriers, o.transponders, o.inhibit_control) for o in world.operations]
    assert found == [
        ("carrier_work", ("c05", "c11"), None, False),
        ("gain_change", None, ("Ku2",), False),
        ("receive_chain_work", None, None, True),
    ]
    start_us = world.scenario.operation_start_us
    assert [(o.start_us - start_us) / 3.6e9 for o in world.operations] == [2.0, 6.0, 8.875]  # a quarter of an hour
    assert all(o.start_us - o.reported_us == 7_200_000_000 for o in world.operations)  # two hours of notice


def test_undeclared_work_is_not_told() -> None:
    silent = built(SwitchOff("off"), GroupStep("gain"), ChainStep("chain"))
    assert silent.operations == ()


def test_a_stale_calibration_meets_new_levels_and_a_new_plan() -> None:
    world = World(replace(scenario_named("stale_calibration"), operation_h=1.0), 1)
    epochs_us, ids = world.rows.epochs_us, world.carrier_ids
    first = int(np.searchsorted(epochs_us, world.scenario.phase("alignment").start_us))
    assert (epochs_us[first] - epochs_us[first - 1]) / 86.4e9 == pytest.approx(30.0, abs=0.01)  # days without a row
    before = {name for name, is_on in zip(ids, world.rows.is_on[first - 1], strict=True) if is_on}
    after = {name for name, is_on in zip(ids, world.rows.is_on[first], strict=True) if is_on}
    assert before - after == {"c06", "c13"}
    assert after - before == {"c16", "c17"}
    assert [{carrier.id for carrier in version.carriers} for version in world.plan_versions] == [before, after]
    assert np.all(np.isnan(world.rows.power_dbm[first - 1]) == ~world.rows.is_on[first - 1])


def test_the_sweep_of_the_clear_sky_is_what_it_was() -> None:
    world = built()
    noise = (measured_dbm(world) - world.rows.power_dbm).std(axis=0)
    np.testing.assert_allclose(noise, sweep_sigma_db(world.plan), rtol=0.1)  # 1300 rows: 2 %, four sigmas
