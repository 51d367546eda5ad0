"""Orbit of the satellite, and where the stations see it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.epochs import US_PER_DAY, US_PER_H, US_PER_S
from analyzer_sim.streams import FloatArray, stream

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


#: rotation of the Earth, rad/s
EARTH_RATE_RAD_S = 7.2921159e-5
#: mean drift of the inclination vector, deg/day
INCLINATION_DRIFT_DEG_DAY = 0.0023
#: error of the predicted track: constant part and daily part, deg, one sigma
TRACK_BIAS_DEG = 0.0008
TRACK_WAVE_DEG = 0.0006

EpochArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Impulse:
    """A burn that changes the orbit at once and leaves the satellite where it is."""

    epoch_us: int
    #: change of the inclination vector towards right ascension 0 and 90 deg
    inclination_deg: tuple[float, float]
    #: change of the drift in longitude
    drift_deg_day: float = 0.0


@dataclass(frozen=True)
class Orbit:
    """True motion of the sub-satellite point."""

    longitude_deg: float
    start_us: int
    #: inclination at the start, deg
    inclination_deg: float
    #: right ascension of the ascending node and of the satellite at the start, rad
    node_rad: float
    ascension_rad: float
    eccentricity: float
    #: mean anomaly at the start, rad
    anomaly_rad: float
    #: burns in order of time
    impulses: tuple[Impulse, ...] = ()

    @classmethod
    def drawn(cls, seed: int, longitude_deg: float, start_us: int) -> "Orbit":
        """Draw an orbit whose inclination the drift lowers at first, yet not to nothing within a month."""
        rng = stream(seed, "orbit")
        node_deg = 270.0 + rng.choice([-1.0, 1.0]) * rng.uniform(22.0, 36.0)
        return cls(
            longitude_deg,
            start_us,
            inclination_deg=rng.uniform(0.0465, 0.049),
            node_rad=float(np.radians(node_deg)),
            ascension_rad=rng.uniform(0.0, 2.0 * np.pi),
            eccentricity=rng.uniform(0.00013, 0.00022),
            anomaly_rad=rng.uniform(0.0, 2.0 * np.pi),
        )

    @cached_property
    def _vector_start_deg(self) -> tuple[float, float]:
        return self.inclination_deg * np.cos(self.node_rad), self.inclination_deg * np.sin(self.node_rad)

    def inclination_vector_deg(self, epochs_us: EpochArray) -> tuple[FloatArray, FloatArray]:
        """Return the components (T,) of the inclination vector towards right ascension 0 and 90 deg."""
        days = (np.asarray(epochs_us) - self.start_us) / US_PER_DAY
        ix, iy = self._vector_start_deg
        components = np.full(days.shape, ix), iy + INCLINATION_DRIFT_DEG_DAY * days
        for impulse in self.impulses:
            is_after = np.asarray(epochs_us) >= impulse.epoch_us
            for component, change_deg in zip(components, impulse.inclination_deg, strict=True):
                component[is_after] += change_deg
        return components

    def right_ascension_rad(self, epochs_us: EpochArray) -> FloatArray:
        """Return the right ascension (T,) of the satellite."""
        angle = EARTH_RATE_RAD_S * (np.asarray(epochs_us) - self.start_us) / US_PER_S
        return np.asarray(angle + self.ascension_rad)

    def sub_satellite_deg(self, epochs_us: EpochArray) -> tuple[FloatArray, FloatArray]:
        """Return latitude and absolute longitude (T,) of the sub-satellite point, deg."""
        angle = EARTH_RATE_RAD_S * (np.asarray(epochs_us) - self.start_us) / US_PER_S
        ix, iy = self.inclination_vector_deg(epochs_us)
        sine, cosine = np.sin(angle + self.ascension_rad), np.cos(angle + self.ascension_rad)
        latitude = ix * sine - iy * cosine
        eccentric = np.degrees(2.0 * self.eccentricity * np.sin(angle + self.anomaly_rad))
        eight = -0.5 * np.radians(1.0) * latitude * (ix * cosine + iy * sine)
        longitude = self.longitude_deg + eccentric + eight
        for impulse in self.impulses:
            days = np.maximum(0, np.asarray(epochs_us) - impulse.epoch_us) / US_PER_DAY
            longitude = longitude + impulse.drift_deg_day * days
        return latitude, longitude

    def position_km(self, epochs_us: EpochArray) -> FloatArray:
        """Return Earth-fixed positions (T, 3), km."""
        latitude, longitude = (np.radians(angle) for angle in self.sub_satellite_deg(epochs_us))
        anomaly = EARTH_RATE_RAD_S * (np.asarray(epochs_us) - self.start_us) / US_PER_S + self.anomaly_rad
        radius = GEO_RADIUS_KM * (1.0 - self.eccentricity * np.cos(anomaly))
        directions = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
        return np.asarray(radius[:, None] * np.stack(directions, axis=1))

    def orbital_from_earth(self, epochs_us: EpochArray) -> FloatArray:
        """Return rotations (T, 3, 3) from the Earth-fixed to the orbital frame."""
        ix, iy = (np.radians(component) for component in self.inclination_vector_deg(epochs_us))
        angle = EARTH_RATE_RAD_S * (np.asarray(epochs_us) - self.start_us) / US_PER_S + self.ascension_rad
        sidereal = angle - np.radians(self.longitude_deg)
        # orbit normal: the pole, tilted by the inclination at right angles to the node
        normal_x = iy * np.cos(sidereal) - ix * np.sin(sidereal)
        normal_y = -iy * np.sin(sidereal) - ix * np.cos(sidereal)
        normal = np.stack([normal_x, normal_y, np.sqrt(1.0 - normal_x**2 - normal_y**2)], axis=1)
        return orbital_from_earth(self.position_km(epochs_us), normal)

    @property
    def nominal_km(self) -> FloatArray:
        """Place (3,) at which the users' dishes were pointed, km."""
        return station_position_km(0.0, self.longitude_deg) * (GEO_RADIUS_KM / EARTH_RADIUS_KM)

    def ascending_nodes_us(self, start_us: int, stop_us: int) -> list[int]:
        """Return the epochs of the northward crossings of the equator in [start, stop)."""
        grid = np.arange(start_us, stop_us + 10 * 60 * US_PER_S, 10 * 60 * US_PER_S, dtype=np.int64)
        latitude, _ = self.sub_satellite_deg(grid)
        rising = np.flatnonzero((latitude[:-1] < 0.0) & (latitude[1:] >= 0.0))
        nodes = [self._crossing_us(int(grid[k]), int(grid[k + 1])) for k in rising]
        return [node for node in nodes if start_us <= node < stop_us]

    def _crossing_us(self, before_us: int, after_us: int) -> int:
        """Halve the interval until the crossing is known to a microsecond."""
        while after_us - before_us > 1:
            middle_us = (before_us + after_us) // 2
            latitude, _ = self.sub_satellite_deg(np.array([middle_us]))
            if latitude[0] < 0.0:
                before_us = middle_us
            else:
                after_us = middle_us
        return after_us


@dataclass(frozen=True, slots=True)
class PredictedTrack:
    """Predicted sub-satellite track that ballistics gives the ground: the true track with a small error."""

    epochs_us: EpochArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray


def predicted_track(
    orbit: Orbit, seed: int, start_us: int, stop_us: int, step_us: int = US_PER_H // 2, *, name: str = "track"
) -> PredictedTrack:
    """Return the predicted track over [start, stop], with a constant and a daily error of some 0.001 deg.

    `name` is the stream of the errors; each prediction has its own.
    """
    epochs_us = np.arange(start_us, stop_us + step_us, step_us, dtype=np.int64)
    rng = stream(seed, name)
    phase = 2.0 * np.pi * (epochs_us - orbit.start_us) / US_PER_DAY
    truth = orbit.sub_satellite_deg(epochs_us)
    tracks = []
    for angle in truth:
        bias, cosine, sine = rng.normal(size=3) * [TRACK_BIAS_DEG, TRACK_WAVE_DEG, TRACK_WAVE_DEG]
        tracks.append(np.round(angle + bias + cosine * np.cos(phase) + sine * np.sin(phase), 6))
    return PredictedTrack(epochs_us, tracks[0], tracks[1])
