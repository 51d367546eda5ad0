"""Weather: fades by rain over a station or the receiving site, and what a wet antenna keeps of it."""

import numpy as np

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.payload.effects import draw
from analyzer_sim.world.scenario.events import DownlinkRain, Storm, UplinkRain

#: rain breathes by this share of its depth, with this correlation time
RAIN_BREATH_SHARE = 0.06
RAIN_BREATH_MIN = 6.0


def rain_db(rain: UplinkRain | DownlinkRain, hours: FloatArray, row_h: float, rng: np.random.Generator) -> FloatArray:
    """Return the fade (T,) of one rain at hours from the start of operation; what it leaves open is drawn here."""
    return shower_db(rain, draw(rng, rain.start_h), hours, row_h, rng)


def shower_db(
    rain: UplinkRain | DownlinkRain | Storm, start_h: float, hours: FloatArray, row_h: float, rng: np.random.Generator
) -> FloatArray:
    """Return the fade (T,) of a rain that begins at a given hour: a trapezoid that breathes."""
    depth_db = draw(rng, rain.depth_db)
    rise_h = depth_db / draw(rng, rain.slope_db_min) / 60.0
    full_h = draw(rng, rain.duration_min) / 60.0
    knots_h = start_h + np.array([0.0, rise_h, rise_h + full_h, 2.0 * rise_h + full_h])
    fade_db = np.interp(hours, knots_h, [0.0, depth_db, depth_db, 0.0])
    wet = np.flatnonzero(fade_db > 0.0)
    breath = rng.normal(size=len(wet))
    keep = np.exp(-row_h * 60.0 / RAIN_BREATH_MIN)
    for row in range(1, len(wet)):
        breath[row] = keep * breath[row - 1] + np.sqrt(1.0 - keep**2) * breath[row]
    fade_db[wet] *= np.maximum(0.0, 1.0 + RAIN_BREATH_SHARE * breath)
    return np.asarray(fade_db)


def wet_antenna_db(fade_db: FloatArray, wet_db: float, dry_tau_min: float, row_h: float) -> FloatArray:
    """Return the loss (T,) of a wet antenna: at most `wet_db` while it rains, then drying with a time constant.

    Examples
    --------
    >>> wet_antenna_db(np.array([0.0, 3.0, 0.0]), 1.0, 20.0, 20.0 / 60.0).round(3).tolist()
    [0.0, 1.0, 0.368]
    """
    keep = float(np.exp(-row_h * 60.0 / dry_tau_min))
    wet = np.minimum(fade_db, wet_db)
    for row in range(int(np.argmax(wet > 0.0)), len(wet)):
        wet[row] = max(wet[row], keep * wet[row - 1] if row else 0.0)
    return np.where(wet > 1e-3, wet, 0.0)
