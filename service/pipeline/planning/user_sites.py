"""Users to look for: places on the ground under the beams, each a carrier with the usual noise of the plan's own."""

import numpy as np

from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.core.geometry.frames import AntennaDirection, satellite_elevation_deg, station_direction
from service.pipeline.inputs.catalogue_checks import LOW_DEG
from service.pipeline.planning.assumed_beams import AssumedPayload, beam_response
from service.pipeline.planning.candidates import Candidates
from service.records.levels.attitude import FloatArray

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
    """Return the name of a site as latitude and longitude."""
    east_deg = (longitude_deg + 180.0) % 360.0 - 180.0
    return (
        f"{abs(latitude_deg):.0f}{'N' if latitude_deg >= 0 else 'S'} {abs(east_deg):.0f}{'E' if east_deg >= 0 else 'W'}"
    )
