"""Planning before any calibration: beams and noise are assumed, stations stand where the carrier plan says.

Gradient and Hessian of a carrier's beam at its station, with the station's displacement by yaw, roll and pitch, give
its response. The downlink to the receiving site changes all carriers alike and is left to the common level. The law of
this file: whatever was assumed stands in ``assumptions``, in words that can be printed beside the figures.

One round parabolic beam shows no yaw: turned about nadir only its centre moves, so ``yaw = el0 pitch - az0 roll`` in
the sensitivities of every station. Plans of one beam say so; shaped beams and several beams are better than this.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.core.estimation.calibration.quadratic_response import (
    QuadraticResponse,
    displacement_matrix,
    exact_response,
    response_transform,
    symmetric_matrix,
)
from service.core.geometry.frames import AntennaDirection, station_direction
from service.pipeline.carrier_model.level_control import MIN_GROUP, alc_groups
from service.pipeline.planning.beam_contours import BeamShape, ContourBeam
from service.pipeline.planning.candidates import NOT_USABLE, Candidates
from service.records.catalogue import Carrier, CarrierPlan
from service.records.levels.attitude import FloatArray, IntArray

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
