"""Beams that a plan assumes, by contours and sites of users."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.geometry_columns import (
    QuadraticResponse,
    displacement_matrix,
    exact_response,
    response_transform,
    symmetric_matrix,
)
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.geometry.frames import AntennaDirection, satellite_elevation_deg, station_direction
from service.pipeline.carrier_model.level_control import MIN_GROUP, alc_groups
from service.pipeline.inputs.catalogue_checks import LOW_DEG, Position, check_positions
from service.pipeline.planning.planning import NOT_USABLE, Candidates
from service.records.catalogue import Carrier, CarrierPlan
from service.records.levels.attitude import FloatArray, IntArray

#: deg, radii within which points are fitted, the first that suffices; fewest points
_REACHES_DEG, _MIN_POINTS = (0.75, 1.5, 3.0), 12
#: error of a point, dB, and largest one of the slope that follows, dB/deg: a single contour has a larger one across it
_POINT_DB, _SLOPE_DB_DEG = 0.1, 0.15


class BeamShape(NamedTuple):
    """Gain of a beam in N directions of the antenna frame; NaN = not known."""

    #: (N,) dB
    gain_db: FloatArray
    #: (N, 2) along azimuth and elevation
    gradient_db_per_deg: FloatArray
    #: (N, 3) azimuth twice, mixed, elevation twice
    hessian_db_per_deg2: FloatArray


@dataclass(frozen=True, eq=False)
class ContourBeam:
    """Beam by P points of gain."""

    #: (P,) deg in the antenna frame, dB
    azimuth_deg: FloatArray
    elevation_deg: FloatArray
    gain_db: FloatArray

    def shape_at(self, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> BeamShape:
        """Return gain, gradient and Hessian in some directions (N,), deg."""
        found = [self._fitted(*one) for one in zip(azimuth_deg.tolist(), elevation_deg.tolist(), strict=True)]
        values = np.array(found).reshape(-1, 6)
        return BeamShape(values[:, 0], values[:, 1:3], values[:, 3:])

    def __str__(self) -> str:
        """Return the number of points and the span of gain."""
        span = f" from {self.gain_db.min():.1f} to {self.gain_db.max():.1f} dB" if len(self.gain_db) else ""
        return f"{len(self.gain_db)} points of gain{span}"

    def _fitted(self, azimuth_deg: float, elevation_deg: float) -> FloatArray:
        """Return gain, gradient (2) and Hessian (3) in one direction, NaN where the points do not determine them."""
        u, v = self.azimuth_deg - azimuth_deg, self.elevation_deg - elevation_deg
        distance_deg = np.hypot(u, v)
        for reach_deg in _REACHES_DEG:
            near = distance_deg < reach_deg
            if np.count_nonzero(near) < _MIN_POINTS:
                continue
            x, y = u[near] / reach_deg, v[near] / reach_deg
            # tricube weights: what stands at the edge must not bend the middle
            weight = (1.0 - (distance_deg[near] / reach_deg) ** 3) ** 1.5
            design = np.column_stack([np.ones_like(x), x, y, 0.5 * x**2, x * y, 0.5 * y**2])
            fit, _, rank, _ = np.linalg.lstsq(design * weight[:, np.newaxis], self.gain_db[near] * weight)
            if rank < design.shape[1]:
                continue
            spread = np.sqrt(np.diagonal(np.linalg.inv((design * weight[:, np.newaxis] ** 2).T @ design)))
            if spread[1:3].max() * _POINT_DB / reach_deg < _SLOPE_DB_DEG:
                return np.asarray(fit / reach_deg ** np.array([0, 1, 1, 2, 2, 2]))
        return np.full(6, np.nan)


class ContourPoint(NamedTuple):
    """One line of a contour file."""

    line: int
    #: ``*`` = every transponder that has no points of its own
    transponder: str
    latitude_deg: float
    longitude_deg: float
    gain_db: float


def contour_beams(
    points: Sequence[ContourPoint], carriers: tuple[Carrier, ...], longitude_deg: float
) -> Mapping[str, ContourBeam]:
    """Return the beam of each transponder by the points of its gain.

    Parameters
    ----------
    points : sequence of ContourPoint
        In any order.
    carriers : tuple of Carrier
        The plan; the points of a transponder must reach a station of it.
    longitude_deg : float, deg
        East longitude of the satellite.

    Raises
    ------
    ValueError
        Points from which the satellite is not seen, or that reach no station.
    """
    positions = [Position(f"line {one.line}", one.latitude_deg, one.longitude_deg) for one in points]
    faults = check_positions(positions, longitude_deg).faults
    # a grid may reach beyond the horizon; most of a coverage does not
    if 2 * len(faults) > len(points):
        message = f"contours: {len(faults)} of {len(points)} points: {faults[0].pointer}: {faults[0].detail}"
        raise ValueError(message)
    beams = {}
    for name in sorted({one.transponder for one in points}):
        own = [one for one in points if one.transponder == name]
        values = np.array([one[2:] for one in own])
        beams[name] = _beam(values, longitude_deg)
        stations = [
            (carrier.station.latitude_deg, carrier.station.longitude_deg)
            for carrier in carriers
            if carrier.station is not None and name in (carrier.transponder, "*")
        ]
        if stations and not _knows_any(beams[name], stations, longitude_deg):
            exchanged = _beam(values[:, [1, 0, 2]], longitude_deg) if np.abs(values[:, 1]).max() <= 90.0 else None
            is_cured = exchanged is not None and _knows_any(exchanged, stations, longitude_deg)
            hint = "latitude and longitude look exchanged" if is_cured else "check transponder, satellite and columns"
            message = f"the points of {name} (first: line {own[0].line}) do not reach a station of the plan; {hint}"
            raise ValueError(message)
    return beams


def _beam(values: FloatArray, longitude_deg: float) -> ContourBeam:
    """Return the beam of points (P, 3): latitude, longitude, gain."""
    latitude_deg, east_deg, gain_db = values.T
    seen = station_direction(east_deg, latitude_deg, np.zeros(len(values)), longitude_deg)
    is_seen = np.isfinite(seen.azimuth_deg)
    return ContourBeam(seen.azimuth_deg[is_seen], seen.elevation_deg[is_seen], gain_db[is_seen])


def _knows_any(beam: ContourBeam, stations: list[tuple[float, float]], longitude_deg: float) -> bool:
    """Return whether the points determine the beam at a station at least."""
    latitude_deg, east_deg = np.array(stations).T
    seen = station_direction(east_deg, latitude_deg, np.zeros(len(stations)), longitude_deg)
    return bool(np.isfinite(beam.shape_at(seen.azimuth_deg, seen.elevation_deg).gain_db).any())


#: half-power widths of a beam of which nothing is known, deg: curvatures of 1.5 and 2.7 dB/deg^2
DEFAULT_WIDTHS_DEG = (4.0, 3.0)


class AssumedBeam(NamedTuple):
    """Parabolic receive beam ``-12 ((az - az0)^2 / w_az^2 + (el - el0)^2 / w_el^2)`` dB: centre, half-power widths."""

    azimuth_deg: float
    elevation_deg: float
    width_azimuth_deg: float
    width_elevation_deg: float

    def shape_at(self, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> BeamShape:
        """Return gain, gradient and Hessian in some directions (N,), deg."""
        apart_deg = np.column_stack([azimuth_deg - self.azimuth_deg, elevation_deg - self.elevation_deg])
        bend = -24.0 / np.array([self.width_azimuth_deg, self.width_elevation_deg]) ** 2
        hessian = np.tile([bend[0], 0.0, bend[1]], (len(apart_deg), 1))
        return BeamShape(0.5 * apart_deg**2 @ bend, apart_deg * bend, hessian)

    def __str__(self) -> str:
        """Return centre and widths."""
        return (
            f"centre az {self.azimuth_deg:+.2f}, el {self.elevation_deg:+.2f} deg, half-power width "
            f"{self.width_azimuth_deg:.1f} x {self.width_elevation_deg:.1f} deg"
        )


Beam = AssumedBeam | ContourBeam


class AssumedNoise(NamedTuple):
    """Noise assumed for every carrier, and its origin."""

    meaning: str
    white_db: float
    #: correlation time in s and sigma in dB of each coloured part
    parts: tuple[tuple[float, float], ...]


#: noise by name; `links` reproduces the spread of 284 measured microwave links within 10 min to a day
NOISES = {
    "quiet": AssumedNoise(
        "steady users: white 0.155 dB and 0.09 dB of 20 min; every carrier counts as stable and linear",
        0.155,
        ((1200.0, 0.09),),
    ),
    "links": AssumedNoise(
        "measured links that flicker: white 0.11 dB, 0.11 dB of 5 min, 0.09 dB of 1 h, 0.16 dB of 6 h; every carrier "
        "counts as stable and linear",
        0.11,
        ((300.0, 0.11), (3600.0, 0.09), (21_600.0, 0.16)),
    ),
}


@dataclass(frozen=True)
class AssumedPayload:
    """Carriers as they would be if the assumptions held."""

    #: East longitude of the satellite, deg
    longitude_deg: float
    candidates: Candidates
    direction: AntennaDirection
    beams: dict[str, Beam]
    #: of the N carriers to the attitude, without error; NaN = not known
    response: QuadraticResponse
    assumptions: tuple[str, ...]


def assume_payload(
    carriers: tuple[Carrier, ...],
    longitude_deg: float,
    noise: AssumedNoise,
    beams: Mapping[str, Beam] | None = None,
) -> AssumedPayload:
    """Return carriers with assumed beams.

    Parameters
    ----------
    carriers : tuple of Carrier
        The plan.
    longitude_deg : float, deg
        East longitude of the satellite.
    noise : AssumedNoise
        Of every carrier.
    beams : mapping, optional
        Beam by name of transponder; the name ``*`` stands for all others. Where nothing is given a transponder's beam
        is centred on the mean direction of its stations, with DEFAULT_WIDTHS_DEG.
    """
    direction = _directions(carriers, longitude_deg)
    chosen, assumptions = _beams_of(carriers, direction, beams or {})
    response = beam_response([chosen.get(carrier.transponder) for carrier in carriers], direction)
    sensitivity = response.slope
    count = len(carriers)
    parts = np.array(noise.parts).reshape(-1, 2)
    unknown = np.full(count, np.nan)
    level, is_seen = alc_groups(CarrierPlan(0, "", carriers)), np.isfinite(direction.azimuth_deg)
    candidates = Candidates(
        tuple(carrier.id for carrier in carriers),
        tuple(carrier.transponder for carrier in carriers),
        sensitivity,
        ColouredNoise(
            np.full(count, noise.white_db), np.tile(parts[:, 1], (count, 1)), np.tile(parts[:, 0], (count, 1))
        ),
        unknown,
        unknown,
        level,
        tuple(
            _refusal(carrier, sensitivity[k], _held_together(level, k), is_seen=bool(is_seen[k]))
            for k, carrier in enumerate(carriers)
        ),
        ((),) * count,
    )
    held = sorted({carrier.transponder for carrier, one in zip(carriers, level, strict=True) if one >= 0})
    if held:
        assumptions += (f"{', '.join(held)} under level control: only differences between their carriers count",)
    reported = (
        *assumptions,
        f"noise: {noise.meaning}",
        "the downlink to the receiving site is left to the common level",
    )
    return AssumedPayload(longitude_deg, candidates, direction, chosen, response, reported)


def _directions(carriers: tuple[Carrier, ...], longitude_deg: float) -> AntennaDirection:
    """Return where stations are seen from the satellite; NaN for a beacon or below its horizon."""
    positions = [
        (np.nan, np.nan) if carrier.station is None else (carrier.station.longitude_deg, carrier.station.latitude_deg)
        for carrier in carriers
    ]
    longitudes, latitudes = np.array(positions, dtype=np.float64).reshape(-1, 2).T
    return station_direction(longitudes, latitudes, np.zeros(len(carriers)), longitude_deg)


def _beams_of(
    carriers: tuple[Carrier, ...], direction: AntennaDirection, given: Mapping[str, Beam]
) -> tuple[dict[str, Beam], tuple[str, ...]]:
    """Return the beam of each transponder that has a visible station, and in words where it came from."""
    beams: dict[str, Beam] = {}
    reported = []
    for name in sorted({carrier.transponder for carrier in carriers}):
        held = np.array([carrier.transponder == name for carrier in carriers]) & np.isfinite(direction.azimuth_deg)
        if not held.any():
            continue
        middle = float(direction.azimuth_deg[held].mean()), float(direction.elevation_deg[held].mean())
        beam = given.get(name, given.get("*"))
        origin = "as stated" if beam is not None else "assumed on the middle of its stations"
        beams[name] = beam or AssumedBeam(*middle, *DEFAULT_WIDTHS_DEG)
        form = "; parabolic" if isinstance(beams[name], AssumedBeam) else ""
        reported.append(f"beam of {name}: {beams[name]}, {origin}{form}")
    beam = next(iter(beams.values()), None)
    if isinstance(beam, AssumedBeam) and set(beams.values()) == {beam}:
        reported.append(
            "one round parabolic beam shows no yaw, whatever the carriers: turned about nadir it looks shifted"
            if beam.width_azimuth_deg == beam.width_elevation_deg
            else "one parabolic beam shows yaw by its ellipticity only; a shaped one shows more"
        )
    return beams, tuple(reported)


def beam_response(beams: Sequence[Beam | None], direction: AntennaDirection) -> QuadraticResponse:
    """Return the response of carriers through their beams; NaN without beam."""
    shapes = np.full((len(beams), 5), np.nan)
    for beam in set(beams) - {None}:
        at = np.array([one == beam for one in beams])
        if beam is not None:
            shape = beam.shape_at(direction.azimuth_deg[at], direction.elevation_deg[at])
            shapes[at] = np.hstack([shape.gradient_db_per_deg, shape.hessian_db_per_deg2])
    displacement = displacement_matrix(direction.azimuth_deg, direction.elevation_deg)
    own, _downlink = response_transform(displacement, np.zeros((2, 3)))
    coefficients = np.einsum("nij,nj->ni", own, shapes)
    return exact_response(coefficients[:, :3], symmetric_matrix(coefficients[:, 3:]))


def _held_together(level: IntArray, k: int) -> int | None:
    """Return how many carriers the level control of a carrier's transponder holds, None without one."""
    return int(np.count_nonzero(level == level[k])) if level[k] >= 0 else None


def _refusal(carrier: Carrier, sensitivity: FloatArray, held_together: int | None, *, is_seen: bool) -> tuple[str, ...]:
    """Return why a carrier cannot be planned with."""
    if not carrier.is_usable_for_attitude:
        return (NOT_USABLE,)
    if held_together is not None and held_together < MIN_GROUP:
        return (f"its transponder is under level control and has fewer than {MIN_GROUP} carriers in the plan",)
    if carrier.station is not None and not is_seen:
        return ("the satellite is below the horizon of its station",)
    return () if np.isfinite(sensitivity).all() else ("the beam of its transponder is not known at its station",)


#: deg between the sites, and dB below the best of them, under which a beam serves nobody
_STEP_DEG, _SERVED_DB = 5.0, 6.0
_FARTHEST_DEG = 75.0


def offered_sites(payload: AssumedPayload, candidates: Candidates) -> Candidates:
    """Return a carrier at every site that a beam serves.

    Parameters
    ----------
    payload : AssumedPayload
        Its beams.
    candidates : Candidates
        Carriers of the plan; the median noise of the usable ones is that of a new user.
    """
    longitude_deg = payload.longitude_deg
    steps_deg = np.arange(-_FARTHEST_DEG, _FARTHEST_DEG + 1.0, _STEP_DEG)
    latitude_deg, east_deg = (grid.ravel() for grid in np.meshgrid(steps_deg, longitude_deg + steps_deg))
    height_m = np.zeros(len(latitude_deg))
    is_high = satellite_elevation_deg(east_deg, latitude_deg, height_m, longitude_deg) > LOW_DEG
    latitude_deg, east_deg = latitude_deg[is_high], east_deg[is_high]
    direction = station_direction(east_deg, latitude_deg, height_m[is_high], longitude_deg)
    names, transponders, slopes = [], [], [np.zeros((0, 3))]
    for transponder, beam in payload.beams.items():
        gain_db = beam.shape_at(direction.azimuth_deg, direction.elevation_deg).gain_db
        if not np.isfinite(gain_db).any():
            continue
        served = np.flatnonzero(gain_db > np.nanmax(gain_db) - _SERVED_DB)
        names += [_name(*site) for site in zip(latitude_deg[served], east_deg[served], strict=True)]
        transponders += [transponder] * len(served)
        slopes.append(
            beam_response([beam] * len(served), AntennaDirection(*(part[served] for part in direction))).slope
        )
    return _usual(names, transponders, np.vstack(slopes), candidates)


def _usual(names: list[str], transponders: list[str], slope: FloatArray, candidates: Candidates) -> Candidates:
    """Return carriers with the median noise of the usable candidates and the level of their transponder."""
    usable = candidates.is_usable if candidates.is_usable.any() else np.ones(len(candidates.level), dtype=np.bool_)
    count = len(names)
    medians = [np.median(part[usable], axis=0) for part in candidates.noise]
    noise = ColouredNoise(*(np.tile(median, (count,) + (1,) * median.ndim) for median in medians))
    levels = dict(zip(candidates.transponders, candidates.level.tolist(), strict=True))
    unknown = np.full(count, np.nan)
    level = np.array([levels.get(name, -1) for name in transponders], dtype=np.int64)
    nothing: tuple[tuple[str, ...], ...] = ((),) * count
    return Candidates(tuple(names), tuple(transponders), slope, noise, unknown, unknown, level, nothing, nothing)


def _name(latitude_deg: float, longitude_deg: float) -> str:
    east_deg = (longitude_deg + 180.0) % 360.0 - 180.0
    return (
        f"{abs(latitude_deg):.0f}{'N' if latitude_deg >= 0 else 'S'} {abs(east_deg):.0f}{'E' if east_deg >= 0 else 'W'}"
    )
