"""Export: a whole world as one compressed numpy file, for campaigns that need no instrument.

The powers carry a Gaussian stand-in for the noise of a sweep (`sweep_noise` times the figure of the default sweep), so
that they look like what a front end would have measured.

==========================  =========  ==============================================================
key                         shape      meaning
==========================  =========  ==============================================================
scenario, seed              ()         what was asked for
epoch_us                    (T,)       microseconds UTC
carrier_id                  (N,)       names of the columns
station_name                (N,)       station of each carrier, of a beacon the receiving site
power_dbm                   (T, N)     measured power, NaN = off, outside its plan or in a gap
yaw_deg roll_deg pitch_deg  (T,)       truth
uplink_fade_db              (T, N)     truth, rain over the users' stations
downlink_fade_db            (T,)       truth, rain over the receiving site, in the band that feels it in full
rain_share                  (N,)       share of that rain which a carrier's band feels
chain_db                    (T,)       truth, change of the receiving chain
level_db                    (T, N)     truth, changes of level: steps, gains, power and level control
pattern_shift_deg           (T, 2)     truth, shift of the uplink patterns, azimuth and elevation
sun_noise_db                (T,)       truth, rise of the noise density by the Sun
burn_us                     (B,)       truth, burns of the orbit
burn_inclination_deg        (B, 2)     truth, their changes of the inclination vector
source                      (T,)       number of the analyzer that measured, place in source_name
source_name                 (2,)       prime, backup
flags                       (T, N)     truth, sum of flag_value of the faults that act
flag_name, flag_value       (F,)       bits of `flags`
sensitivity_db_per_deg      (N, 3)     truth at nominal attitude, order yaw, roll, pitch
white_db                    (N,)       white noise of a row, the world's and the sweep's together
noise_free_dbm              (T, N)     truth, levels without noise and rain of stations, chain and receiving site
row_sensitivity_db_per_deg  (T, N, 3)  truth at the attitude of the row, order yaw, roll, pitch
part_sigma_db, part_tau_s   (N, Q)     truth, first-order parts of a carrier's noise; sigma 0 = no further part
daily_db                    (N,)       truth, amplitude of the wave of the solar day
chain_part_sigma_db         (C,)       truth, first-order parts of the receiving chain
chain_part_tau_s            (C,)       truth, likewise
chain_daily_db              ()         truth, amplitude of the chain's wave of the solar day
drift_sigma_deg_h           (3,)       truth, drift of the inertial model, order yaw, roll, pitch
drift_tau_s                 ()         truth, its correlation time
is_coupled                  ()         truth, whether roll and yaw exchange
correction_scale_sigma      ()         truth, error of the effect of corrections, relative
motion_json                 ()         truth, statistics of wheels, rates and polarimeter (`motion_statistics.py`)
polarimeter_turn_deg        (T,)       truth, turn of the body that a polarimeter follows; (0,) = there is none
phase_name                  (P,)       quiet, turns, perhaps pause, alignment, operation
phase_start_us, _stop_us    (P,)       start inclusive, stop exclusive
reference_epoch_us          (R,)       references of all sensors, in order of epoch, until operation begins
reference_source            (R,)       star_tracker, earth_sensor or radio_beacon
reference_{angle}_deg       (R,)       NaN = the sensor does not tell it
reference_sigma_{angle}_deg  (R,)      NaN likewise
witness_epoch_us            (W,)       truth: sensors in operation, when the ground does not read them
witness_source              (W,)       truth, as reference_source
witness_{angle}_deg         (W,)       truth, as reference_{angle}_deg
witness_sigma_{angle}_deg   (W,)       truth, likewise
reference_sigma_deg         (3,)       the same by axis, order yaw, roll, pitch: an axis has one sensor
correction_start_us, _stop_us  (C,)    corrections announced to the ground
correction_{angle}_deg      (C,)       total over the interval
correction_told_us          (C,)       when the ground is told: at the start, or late (then in news_json too)
turn_start_us, _stop_us     (M,)       timetable of the calibration turns, after the slews
turn_{angle}_deg            (M,)
node_us                     (K,)       ascending nodes
nodal_period_s              ()
track_epoch_us              (S,)       predicted track
track_latitude_deg, track_longitude_deg  (S,)
catalogue_json              ()         spacecraft, carriers, task and ephemeris as sent by the ground port
news_us                     (L,)       epochs from which the ground knows more
news_json                   ()         L lines as the ground port sends them: plans, tasks, ephemerides, operations ...
==========================  =========  ==============================================================
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import FloatArray, stream
from analyzer_sim.world.ground.ground import catalogue_lines, events
from analyzer_sim.world.motion_statistics import motion_statistics
from analyzer_sim.world.orbit import predicted_track
from analyzer_sim.world.payload.carriers import ROLLOFF
from analyzer_sim.world.payload.effects import SOURCES
from analyzer_sim.world.payload.level_terms import carrier_noise, sensitivity_db_per_deg, sweep_sigma_db
from analyzer_sim.world.polarimeter import body_turn_deg
from analyzer_sim.world.scenario.story import SLEW_MIN, TIMETABLE, Scenario
from analyzer_sim.world.sensors import References
from analyzer_sim.world.world import World, flag_names

AXES = ("yaw", "roll", "pitch")


def measured_dbm(world: World, sweep_noise: float = 1.0) -> FloatArray:
    """Return the powers (T, N) with a Gaussian stand-in for the noise of a sweep."""
    return np.asarray(world.rows.power_dbm + sweep_noise_db(world, sweep_noise))


def sweep_noise_db(world: World, sweep_noise: float = 1.0) -> FloatArray:
    """Return the stand-in (T, N) for the noise of a sweep; it grows when the Sun raises the noise."""
    noise = np.stack(
        [stream(world.seed, "sweep", name).normal(size=len(world.rows.epochs_us)) for name in world.carrier_ids], axis=1
    )
    return np.asarray(sweep_noise * sweep_sigma_db(world.plan) * _growth(world) * noise)


def _growth(world: World) -> FloatArray:
    """Return by how much (T, N) the Sun's noise spreads a carrier's power: (C + N) / C against the clear sky's."""
    plan = world.plan
    over_noise_db = [c.c_n0_db_hz - 10.0 * np.log10(c.bandwidth_hz / (1.0 + ROLLOFF)) for c in plan.carriers]
    clear = 10.0 ** (-np.array(over_noise_db) / 10.0)
    risen = 10.0 ** (world.rows.sun_noise_db / 10.0)
    return np.asarray((1.0 + clear * risen[:, None]) / (1.0 + clear))


def export_arrays(world: World, sweep_noise: float = 1.0) -> dict[str, Any]:
    """Return the arrays of the export by key; the table of the module says what each holds."""
    return {
        **_truth(world),
        "power_dbm": measured_dbm(world, sweep_noise),
        **_statistics(world, sweep_noise),
        **_knowledge(world),
        **_ballistics(world),
        "catalogue_json": json.dumps(list(catalogue_lines(world)), allow_nan=False),
        **_ground_events(world),
    }


def export_npz(world: World, path: Path, sweep_noise: float = 1.0) -> None:
    """Write a world to a compressed numpy file."""
    with path.open("wb") as file:
        np.savez_compressed(file, **export_arrays(world, sweep_noise))


def run_export(scenario: Scenario, seed: int, out: Path, sweep_noise: float = 1.0) -> int:
    """Build the world of a scenario, write it to a file, say so, and return the exit status."""
    world = World(scenario, seed)
    export_npz(world, out, sweep_noise)
    count, carriers = world.rows.power_dbm.shape
    sys.stdout.write(f"{out}: scenario {scenario.name}, seed {seed}, {count} rows, {carriers} carriers\n")
    return 0


def _by_axis(prefix: str, attitude_deg: FloatArray) -> dict[str, FloatArray]:
    return {f"{prefix}{axis}_deg": attitude_deg[:, number] for number, axis in enumerate(AXES)}


def _truth(world: World) -> dict[str, Any]:
    rows, names = world.rows, flag_names()
    return {
        "scenario": world.scenario.name,
        "seed": world.seed,
        "epoch_us": rows.epochs_us,
        "carrier_id": np.array(world.carrier_ids),
        "station_name": np.array([carrier.station.name for carrier in world.plan.carriers]),
        **_by_axis("", rows.attitude_deg),
        "uplink_fade_db": rows.uplink_fade_db,
        "downlink_fade_db": rows.downlink_fade_db,
        "rain_share": world.plan.rain_share,
        "chain_db": rows.chain_db,
        "level_db": rows.level_db,
        "pattern_shift_deg": rows.pattern_shift_deg,
        "sun_noise_db": rows.sun_noise_db,
        "burn_us": np.array([impulse.epoch_us for impulse in world.orbit.impulses], dtype=np.int64),
        "burn_inclination_deg": np.array([i.inclination_deg for i in world.orbit.impulses]).reshape(-1, 2),
        "source": rows.source,
        "source_name": np.array(SOURCES),
        "flags": rows.flags,
        "flag_name": np.array(list(names)),
        "flag_value": np.array(list(names.values())),
        "sensitivity_db_per_deg": sensitivity_db_per_deg(world.plan, world.orbit),
    }


def _statistics(world: World, sweep_noise: float) -> dict[str, Any]:
    """Return what noise and motion were drawn from, and the levels and slopes that they act on."""
    noises = [carrier_noise(world.plan, column, world.scenario, world.seed) for column in range(len(world.carrier_ids))]
    parts = np.zeros((len(noises), max(1, *(len(noise.parts) for noise in noises)), 2))
    parts[..., 1] = 1.0
    for k, noise in enumerate(noises):
        parts[k, : len(noise.parts)] = np.array(noise.parts).reshape(-1, 2)
    figures, keeping = world.scenario.noise, world.scenario.keeping
    chain = np.array([(figures.chain_db, figures.chain_tau_s), *figures.chain_flicker])
    return {
        "white_db": np.hypot([noise.white_db for noise in noises], sweep_noise * sweep_sigma_db(world.plan)),
        "noise_free_dbm": world.terms.noise_free_dbm(world.rows.carrier_dbm),
        # seven digits are more than a judge needs, and half the file
        "row_sensitivity_db_per_deg": world.terms.row_sensitivity_db_per_deg(world.rows.attitude_deg).astype("f4"),
        "part_sigma_db": parts[..., 0],
        "part_tau_s": parts[..., 1],
        "daily_db": np.array([noise.daily_db for noise in noises]),
        "chain_part_sigma_db": chain[:, 0],
        "chain_part_tau_s": chain[:, 1],
        "chain_daily_db": figures.chain_daily_db,
        "drift_sigma_deg_h": np.array(keeping.drift_deg_h),
        "drift_tau_s": keeping.drift_tau_s,
        "is_coupled": keeping.is_coupled,
        "correction_scale_sigma": keeping.scale_error,
        "motion_json": json.dumps(motion_statistics(world), allow_nan=False),
        "polarimeter_turn_deg": _polarimeter_turn_deg(world),
    }


def _polarimeter_turn_deg(world: World) -> FloatArray:
    """Return the turn (T,) that the polarimeter follows, (0,) where there is none."""
    if world.scenario.polarimeter is None:
        return np.empty(0)
    rows = world.rows
    return body_turn_deg(world.orbit, world.plan.receiving_site, rows.epochs_us, rows.attitude_deg)


def _ground_events(world: World) -> dict[str, Any]:
    reported = sorted(events(world), key=lambda item: item[0])
    return {
        "news_us": np.array([epoch_us for epoch_us, _line in reported], dtype=np.int64),
        "news_json": json.dumps([line for _epoch_us, line in reported], allow_nan=False),
    }


def _knowledge(world: World) -> dict[str, Any]:
    phases = world.scenario.phases
    turns_us = world.scenario.phase("turns").start_us
    turns = [turn for turn in TIMETABLE if any(turn.attitude_deg)]
    reported = np.array([c.attitude_deg for c in world.corrections]).reshape(-1, 3)
    return {
        "phase_name": np.array([phase.name for phase in phases]),
        "phase_start_us": np.array([phase.start_us for phase in phases]),
        "phase_stop_us": np.array([phase.stop_us for phase in phases]),
        **_sensed("reference", world.references),
        **_sensed("witness", world.witnesses),
        "reference_sigma_deg": np.nanmax([sensor.sigma_deg for sensor in world.scenario.sensors], axis=0),
        "correction_start_us": np.array([c.start_us for c in world.corrections], dtype=np.int64),
        "correction_stop_us": np.array([c.stop_us for c in world.corrections], dtype=np.int64),
        **_by_axis("correction_", reported),
        "correction_told_us": np.array([c.reported_us for c in world.corrections], dtype=np.int64),
        "turn_start_us": np.array([turns_us + (turn.start_min + SLEW_MIN) * 60 * US_PER_S for turn in turns]),
        "turn_stop_us": np.array([turns_us + turn.stop_min * 60 * US_PER_S for turn in turns]),
        **_by_axis("turn_", np.array([turn.attitude_deg for turn in turns])),
    }


def _sensed(name: str, reported: References) -> dict[str, Any]:
    return {
        f"{name}_epoch_us": reported.epochs_us,
        **_by_axis(f"{name}_", reported.attitude_deg),
        f"{name}_source": reported.source,
        **_by_axis(f"{name}_sigma_", reported.sigma_deg),
    }


def _ballistics(world: World) -> dict[str, Any]:
    reported = world.ephemerides[0]
    track = predicted_track(reported.orbit, world.seed, reported.start_us, reported.stop_us, name=reported.stream_name)
    return {
        "node_us": np.array(reported.nodes_us, dtype=np.int64),
        "nodal_period_s": reported.nodal_period_s,
        "track_epoch_us": track.epochs_us,
        "track_latitude_deg": track.latitude_deg,
        "track_longitude_deg": track.longitude_deg,
    }
