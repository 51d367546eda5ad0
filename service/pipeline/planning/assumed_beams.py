"""Planning before any calibration: beams and noise are assumed, stations stand where the carrier plan says.

Beam: ``G = -12 ((az - az0)^2 / w_az^2 + (el - el0)^2 / w_el^2)`` dB, w the half-power widths in deg, hence a gradient
of ``-24 (az - az0) / w_az^2`` dB/deg at the station and, with the station's displacement by yaw, roll and pitch, a
sensitivity. The downlink to the receiving site changes all carriers alike and is left to the common level. The law of
this file: whatever was assumed stands in ``assumptions``, in words that can be printed beside the figures.

One round parabolic beam shows no yaw: turned about nadir only its centre moves, so ``yaw = el0 pitch - az0 roll`` in
the sensitivities of every station. Plans of one beam say so; shaped beams and several beams are better than this.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.core.estimation.calibration.quadratic_response import displacement_matrix
from service.core.geometry.frames import AntennaDirection, station_direction
from service.pipeline.carrier_model.level_control import MIN_GROUP, alc_groups
from service.pipeline.planning.candidates import NOT_USABLE, Candidates
from service.records.catalogue import Carrier, CarrierPlan
from service.records.levels.attitude import FloatArray, IntArray

#: half-power widths of a beam of which nothing is known, deg: curvatures of 1.5 and 2.7 dB/deg^2
DEFAULT_WIDTHS_DEG = (4.0, 3.0)


class AssumedBeam(NamedTuple):
    """Centre in the antenna frame and half-power widths of a receive beam, deg."""

    azimuth_deg: float
    elevation_deg: float
    width_azimuth_deg: float
    width_elevation_deg: float


class AssumedNoise(NamedTuple):
    """Noise assumed for every carrier, and its origin."""

    meaning: str
    white_db: float
    #: correlation time in s and sigma in dB of each coloured part
    parts: tuple[tuple[float, float], ...]


#: noise by name; `links` reproduces the spread of 284 measured microwave links within 10 min to a day
NOISES = {
    "quiet": AssumedNoise("steady users: white 0.155 dB and 0.09 dB of 20 min", 0.155, ((1200.0, 0.09),)),
    "links": AssumedNoise(
        "measured links that flicker: white 0.11 dB, 0.11 dB of 5 min, 0.09 dB of 1 h, 0.16 dB of 6 h",
        0.11,
        ((300.0, 0.11), (3600.0, 0.09), (21_600.0, 0.16)),
    ),
}


@dataclass(frozen=True)
class AssumedPayload:
    """Carriers as they would be if the assumptions held."""

    candidates: Candidates
    direction: AntennaDirection
    beams: dict[str, AssumedBeam]
    assumptions: tuple[str, ...]


def assume_payload(
    carriers: tuple[Carrier, ...],
    longitude_deg: float,
    noise: AssumedNoise,
    beams: Mapping[str, AssumedBeam] | None = None,
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
    per_carrier = [chosen.get(carrier.transponder) for carrier in carriers]
    gradient = np.array([_gradient(beam, direction, k) for k, beam in enumerate(per_carrier)]).reshape(-1, 1, 2)
    positions = displacement_matrix(direction.azimuth_deg, direction.elevation_deg)
    sensitivity = (gradient @ positions)[:, 0]
    count = len(carriers)
    parts = np.array(noise.parts).reshape(-1, 2)
    unknown = np.full(count, np.nan)
    level = alc_groups(CarrierPlan(0, "", carriers))
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
        tuple(_refusal(carrier, sensitivity[k], _held_together(level, k)) for k, carrier in enumerate(carriers)),
        ((),) * count,
    )
    held = sorted({carrier.transponder for carrier, one in zip(carriers, level, strict=True) if one >= 0})
    if held:
        assumptions += (f"{', '.join(held)} under level control: only differences between their carriers count",)
    reported = (
        *assumptions,
        f"noise: {noise.meaning}",
        "every carrier counts as stable and linear; the downlink to the receiving site is left to the common level",
    )
    return AssumedPayload(candidates, direction, chosen, reported)


def _directions(carriers: tuple[Carrier, ...], longitude_deg: float) -> AntennaDirection:
    """Return where stations are seen from the satellite; NaN for a beacon or below its horizon."""
    positions = [
        (np.nan, np.nan) if carrier.station is None else (carrier.station.longitude_deg, carrier.station.latitude_deg)
        for carrier in carriers
    ]
    longitudes, latitudes = np.array(positions, dtype=np.float64).reshape(-1, 2).T
    return station_direction(longitudes, latitudes, np.zeros(len(carriers)), longitude_deg)


def _beams_of(
    carriers: tuple[Carrier, ...], direction: AntennaDirection, given: Mapping[str, AssumedBeam]
) -> tuple[dict[str, AssumedBeam], tuple[str, ...]]:
    """Return the beam of each transponder that has a visible station, and in words where it came from."""
    beams: dict[str, AssumedBeam] = {}
    reported = []
    for name in sorted({carrier.transponder for carrier in carriers}):
        held = np.array([carrier.transponder == name for carrier in carriers]) & np.isfinite(direction.azimuth_deg)
        if not held.any():
            continue
        middle = float(direction.azimuth_deg[held].mean()), float(direction.elevation_deg[held].mean())
        beam = given.get(name, given.get("*"))
        origin = "as stated" if beam is not None else "assumed on the middle of its stations"
        beams[name] = beam or AssumedBeam(*middle, *DEFAULT_WIDTHS_DEG)
        centre_az, centre_el, width_az, width_el = beams[name]
        reported.append(
            f"beam of {name}: centre az {centre_az:+.2f}, el {centre_el:+.2f} deg, half-power width {width_az:.1f} x "
            f"{width_el:.1f} deg, {origin}; parabolic"
        )
    if len(set(beams.values())) == 1:
        beam = next(iter(beams.values()))
        reported.append(
            "one round parabolic beam shows no yaw, whatever the carriers: turned about nadir it looks shifted"
            if beam.width_azimuth_deg == beam.width_elevation_deg
            else "one parabolic beam shows yaw by its ellipticity only; a shaped one shows more"
        )
    return beams, tuple(reported)


def _gradient(beam: AssumedBeam | None, direction: AntennaDirection, k: int) -> tuple[float, float]:
    """Return the slope of a beam at the k-th station, dB/deg; NaN without beam."""
    if beam is None:
        return (np.nan, np.nan)
    return (
        -24.0 * float(direction.azimuth_deg[k] - beam.azimuth_deg) / beam.width_azimuth_deg**2,
        -24.0 * float(direction.elevation_deg[k] - beam.elevation_deg) / beam.width_elevation_deg**2,
    )


def _held_together(level: IntArray, k: int) -> int | None:
    """Return how many carriers the level control of a carrier's transponder holds, None without one."""
    return int(np.count_nonzero(level == level[k])) if level[k] >= 0 else None


def _refusal(carrier: Carrier, sensitivity: FloatArray, held_together: int | None) -> tuple[str, ...]:
    """Return why a carrier cannot be planned with."""
    if not carrier.is_usable_for_attitude:
        return (NOT_USABLE,)
    if held_together is not None and held_together < MIN_GROUP:
        return (f"its transponder is under level control and has fewer than {MIN_GROUP} carriers in the plan",)
    return () if np.isfinite(sensitivity).all() else ("the satellite is below the horizon of its station",)
