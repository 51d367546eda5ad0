"""Directions from the satellite: orbital frame, body frame, antenna frame.

Body axes at zero attitude: x roll/East (flight), y pitch/South, z yaw/nadir. The body stands to the orbital frame by
the 3-2-1 turn yaw, pitch, roll. Antenna frame: `tan az = x / z` (East), `tan el = -y / z` (North). Everything is
rotated exactly; the first-order formulas `daz = -pitch - yaw el`, `del = -roll + yaw az` serve the tests only.
"""

import numpy as np

from analyzer_sim.streams import FloatArray

#: WGS-84 ellipsoid, km and flattening
EARTH_RADIUS_KM = 6378.137
EARTH_FLATTENING = 1.0 / 298.257223563
#: radius of the geostationary orbit, km
GEO_RADIUS_KM = 42164.17


def station_position_km(latitude_deg: float, longitude_deg: float, height_m: float = 0.0) -> FloatArray:
    """Return the Earth-fixed position (3,) of a station, km."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    e2 = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)
    normal_km = EARTH_RADIUS_KM / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    height_km = height_m / 1000.0
    across = (normal_km + height_km) * np.cos(latitude)
    along = (normal_km * (1.0 - e2) + height_km) * np.sin(latitude)
    return np.array([across * np.cos(longitude), across * np.sin(longitude), along])


def unit(vectors: FloatArray) -> FloatArray:
    """Scale vectors (..., 3) to length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def orbital_from_earth(position_km: FloatArray, normal: FloatArray) -> FloatArray:
    """Return rotations (T, 3, 3) from the Earth-fixed to the orbital frame x flight, y anti-normal (South), z nadir.

    `position_km` and `normal` (orbit normal, unit) have shape (T, 3).
    """
    z = -unit(position_km)
    y = -unit(normal - np.sum(normal * z, axis=1, keepdims=True) * z)
    return np.stack([np.cross(y, z), y, z], axis=1)


def body_from_orbital(attitude_deg: FloatArray) -> FloatArray:
    """Return rotations (T, 3, 3) of the 3-2-1 turn for attitudes (T, 3) in the order yaw, roll, pitch."""
    yaw, roll, pitch = np.radians(np.asarray(attitude_deg, dtype=float)).T
    cy, sy, cr, sr, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (1, 2))


def antenna_angles_deg(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return azimuth (East) and elevation (North) from nadir, deg, of body-frame directions (..., 3)."""
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    return np.degrees(np.arctan2(x, z)), np.degrees(np.arctan2(-y, z))


def antenna_frame_deg(
    body_from_earth: FloatArray, satellite_km: FloatArray, stations_km: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return azimuth and elevation (T, N) of stations (N, 3) seen from positions (T, 3) through rotations (T, 3, 3)."""
    sight = stations_km[None, :, :] - satellite_km[:, None, :]
    return antenna_angles_deg(np.einsum("tij,tnj->tni", body_from_earth, sight))


def dish_motion_deg(station_km: FloatArray, nominal_km: FloatArray, satellite_km: FloatArray) -> FloatArray:
    """Return how far the satellite stands from its nominal place in the sky of a station, deg.

    Shape (T, 2): along the station's horizontal (positive East) and across it (positive up).
    """
    boresight = unit(nominal_km - station_km)
    across = unit(np.cross(np.array([0.0, 0.0, 1.0]), boresight))
    up = np.cross(boresight, across)
    sight = satellite_km - station_km
    depth = sight @ boresight
    return np.asarray(np.degrees(np.stack([np.arctan2(sight @ across, depth), np.arctan2(sight @ up, depth)], axis=1)))
