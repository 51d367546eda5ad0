"""Receive beams stated by points of gain on the ground: contours or a grid, as an operator's coverage files give them.

Around each station a quadratic is fitted to the points nearby; its gradient and Hessian are those of the beam there.
The law of this file: where the points do not determine a quadratic the beam is not known, and nothing is extrapolated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.geometry.frames import station_direction
from service.pipeline.inputs.catalogue_checks import Position, check_positions
from service.records.catalogue import Carrier
from service.records.levels.attitude import FloatArray

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
