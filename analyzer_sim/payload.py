"""Payload: level changes of the carriers caused by where the satellite points and stands.

    change_i = G_uplink(az_i, el_i) - G_uplink(nominal)
             + G_downlink(site) - G_downlink(nominal) - loss of the user's dish

The downlink term is one and the same for all carriers.
"""

from collections.abc import Sequence

import numpy as np

from analyzer_sim.beams import Beam
from analyzer_sim.carriers import CarrierPlan, Station
from analyzer_sim.dish import dish_loss_db, mispointing_deg
from analyzer_sim.geometry import antenna_frame_deg, body_from_orbital, dish_motion_deg, station_position_km
from analyzer_sim.orbit import EpochArray, Orbit
from analyzer_sim.streams import FloatArray


def positions_km(stations: Sequence[Station]) -> FloatArray:
    """Return Earth-fixed positions (N, 3)."""
    return np.array([station_position_km(s.latitude_deg, s.longitude_deg, s.height_m) for s in stations])


def plan_positions_km(plan: CarrierPlan) -> FloatArray:
    """Return positions (N + 1, 3) of the plan's stations and, last, of the receiving site."""
    return positions_km([*(carrier.station for carrier in plan.carriers), plan.receiving_site])


def pattern_gain_db(plan: CarrierPlan, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return gains (T, N): uplink beam of each carrier plus the common downlink; angles (T, N + 1), the site last."""
    beams: list[Beam] = [plan.beams[carrier.transponder] for carrier in plan.carriers]
    uplink = np.stack([beam.gain_db(azimuth_deg[:, k], elevation_deg[:, k]) for k, beam in enumerate(beams)], axis=1)
    downlink = plan.downlink_beam.gain_db(azimuth_deg[:, -1], elevation_deg[:, -1])
    return np.asarray(uplink + downlink[:, None])


def nominal_gain_db(plan: CarrierPlan, orbit: Orbit, attitude_deg: FloatArray) -> FloatArray:
    """Return gains (T, N) for attitudes (T, 3) with the satellite at its nominal place."""
    start = np.array([orbit.start_us])
    still = Orbit(orbit.longitude_deg, orbit.start_us, 0.0, 0.0, 0.0, 0.0, 0.0)
    body_from_earth = body_from_orbital(attitude_deg) @ still.orbital_from_earth(start)
    place_km = np.broadcast_to(orbit.nominal_km, (len(attitude_deg), 3))
    return pattern_gain_db(plan, *antenna_frame_deg(body_from_earth, place_km, plan_positions_km(plan)))


def sensitivity_db_per_deg(plan: CarrierPlan, orbit: Orbit, step_deg: float = 0.01) -> FloatArray:
    """Return the true sensitivities (N, 3) at nominal attitude by central differences, order yaw, roll, pitch."""
    steps = step_deg * np.eye(3)
    gains = nominal_gain_db(plan, orbit, np.concatenate([steps, -steps]))
    return np.asarray((gains[:3] - gains[3:]).T / (2.0 * step_deg))


def attitude_gain_db(plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the change of gain (T, N) against nominal attitude and place."""
    body_from_earth = body_from_orbital(attitude_deg) @ orbit.orbital_from_earth(epochs_us)
    angles = antenna_frame_deg(body_from_earth, orbit.position_km(epochs_us), plan_positions_km(plan))
    return pattern_gain_db(plan, *angles) - nominal_gain_db(plan, orbit, np.zeros((1, 3)))


def dishes_loss_db(plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, seed: int) -> FloatArray:
    """Return the losses (T, N) of the users' fixed dishes."""
    satellite_km, nominal_km = orbit.position_km(epochs_us), orbit.nominal_km
    losses = []
    for carrier, station_km in zip(plan.carriers, plan_positions_km(plan), strict=False):  # the site comes last, unused
        motion = dish_motion_deg(station_km, nominal_km, satellite_km)
        offset = mispointing_deg(seed, carrier.id, carrier.dish_width_deg)
        losses.append(dish_loss_db(motion, offset, carrier.dish_width_deg))
    return np.stack(losses, axis=1)
