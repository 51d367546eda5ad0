"""Payload: level changes of the carriers caused by where the satellite points and stands.

    change_i = G_uplink(az_i, el_i) - G_uplink(nominal)
             + G_downlink(site) - G_downlink(nominal) - loss of the user's dish

The downlink term is one and the same for all carriers of a band.
"""

from collections.abc import Sequence

import numpy as np

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.orbit.geometry import antenna_frame_deg, body_from_orbital, dish_motion_deg, station_position_km
from analyzer_sim.world.orbit.orbit import EpochArray, Orbit
from analyzer_sim.world.payload.beams import Beam
from analyzer_sim.world.payload.carriers import CarrierPlan, Station
from analyzer_sim.world.payload.dish import dish_loss_db, mispointing_deg


def positions_km(stations: Sequence[Station]) -> FloatArray:
    """Return Earth-fixed positions (N, 3)."""
    return np.array([station_position_km(s.latitude_deg, s.longitude_deg, s.height_m) for s in stations])


def plan_positions_km(plan: CarrierPlan) -> FloatArray:
    """Return positions (N + 1, 3) of the plan's stations and, last, of the receiving site."""
    return positions_km([*(carrier.station for carrier in plan.carriers), plan.receiving_site])


def uplink_gain_db(plan: CarrierPlan, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return gains (T, N) of each carrier's uplink beam, 0 for a beacon; angles (T, N + 1), the site last."""
    gains = np.zeros((len(azimuth_deg), len(plan.carriers)))
    for k in plan.users:
        beam: Beam = plan.beams[plan.carriers[k].transponder]
        gains[:, k] = beam.gain_db(azimuth_deg[:, k], elevation_deg[:, k])
    return gains


def pattern_gain_db(
    plan: CarrierPlan, azimuth_deg: FloatArray, elevation_deg: FloatArray, shift_deg: FloatArray | None = None
) -> FloatArray:
    """Return gains (T, N): uplink beam of each carrier plus its band's downlink; angles (T, N + 1), the site last.

    `shift_deg` (T, 2) turns the uplink patterns against the body.
    """
    if shift_deg is None:
        uplink = uplink_gain_db(plan, azimuth_deg, elevation_deg)
    else:
        uplink = uplink_gain_db(plan, azimuth_deg - shift_deg[:, :1], elevation_deg - shift_deg[:, 1:])
    site = azimuth_deg[:, -1], elevation_deg[:, -1]
    downlinks = {band: beam.gain_db(*site) for band, beam in plan.downlink_beams.items()}
    return np.asarray(uplink + np.stack([downlinks[carrier.band] for carrier in plan.carriers], axis=1))


def nominal_gain_db(plan: CarrierPlan, orbit: Orbit, attitude_deg: FloatArray) -> FloatArray:
    """Return gains (T, N) for attitudes (T, 3) with the satellite at its nominal place."""
    start = np.array([orbit.start_us])
    still = Orbit(orbit.longitude_deg, orbit.start_us, 0.0, 0.0, 0.0, 0.0, 0.0)
    body_from_earth = body_from_orbital(attitude_deg) @ still.orbital_from_earth(start)
    site_km = np.broadcast_to(orbit.nominal_km, (len(attitude_deg), 3))
    return pattern_gain_db(plan, *antenna_frame_deg(body_from_earth, site_km, plan_positions_km(plan)))


def sensitivity_db_per_deg(plan: CarrierPlan, orbit: Orbit, step_deg: float = 0.01) -> FloatArray:
    """Return the true sensitivities (N, 3) at nominal attitude by central differences, order yaw, roll, pitch."""
    steps = step_deg * np.eye(3)
    gains = nominal_gain_db(plan, orbit, np.concatenate([steps, -steps]))
    return np.asarray((gains[:3] - gains[3:]).T / (2.0 * step_deg))


def flown_gain_db(
    plan: CarrierPlan,
    orbit: Orbit,
    epochs_us: EpochArray,
    attitude_deg: FloatArray,
    shift_deg: FloatArray | None = None,
) -> FloatArray:
    """Return gains (T, N) at attitudes (T, 3) with the satellite where it is; `shift_deg` as in `pattern_gain_db`."""
    return pattern_gain_db(plan, *_antenna_angles_deg(plan, orbit, epochs_us, attitude_deg), shift_deg)


def uplink_change_db(plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, attitude_deg: FloatArray) -> FloatArray:
    """Return the change (T, N) of the uplink beams' gain alone: what the satellite's receivers see."""
    angles = _antenna_angles_deg(plan, orbit, epochs_us, attitude_deg)
    start = np.array([orbit.start_us])
    still = Orbit(orbit.longitude_deg, orbit.start_us, 0.0, 0.0, 0.0, 0.0, 0.0)
    nominal = _antenna_angles_deg(plan, still, start, np.zeros((1, 3)))
    return uplink_gain_db(plan, *angles) - uplink_gain_db(plan, *nominal)


def _antenna_angles_deg(
    plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, attitude_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return azimuth and elevation (T, N + 1) of the stations and the site in the antenna frame."""
    body_from_earth = body_from_orbital(attitude_deg) @ orbit.orbital_from_earth(epochs_us)
    return antenna_frame_deg(body_from_earth, orbit.position_km(epochs_us), plan_positions_km(plan))


def dishes_loss_db(plan: CarrierPlan, orbit: Orbit, epochs_us: EpochArray, seed: int) -> FloatArray:
    """Return the losses (T, N) of the users' fixed dishes; a beacon has none."""
    satellite_km, nominal_km = orbit.position_km(epochs_us), orbit.nominal_km
    stations_km = plan_positions_km(plan)
    losses = np.zeros((len(epochs_us), len(plan.carriers)))
    for k in plan.users:
        carrier = plan.carriers[k]
        motion = dish_motion_deg(stations_km[k], nominal_km, satellite_km)
        offset = mispointing_deg(seed, carrier.id, carrier.dish_width_deg)
        losses[:, k] = dish_loss_db(motion, offset, carrier.dish_width_deg)
    return losses
