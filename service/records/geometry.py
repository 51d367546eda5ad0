"""Calibration by station geometry as the archive keeps it: everything the robust method computes with.

Arrays are nested tuples in the order of the calibration's carriers; NaN marks what was not found. Angles of stations
and of the receiving site are those of the antenna frame that the fit used, so that a later change of the catalogue does
not move a calibration.
"""

from dataclasses import dataclass

from service.records.noise import NoiseComponent

Row = tuple[float, ...]
Table = tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class GeometryFit:
    """Joint fit of N carriers with D daily coefficients and R bands; K = 1 + D + 5 own coefficients."""

    #: whether ``daily`` is the dish law (b1, b2 in dB/deg, k in dB/deg^2), else two harmonics in dB
    is_dish_law: bool
    #: names of the R bands and (N,) the number of each carrier's band
    bands: tuple[str, ...]
    band: tuple[int, ...]
    #: (R,) share of the receiving site's rain that each band takes, Ku 1
    rain_share: Row
    #: names of the transponders and (N,) the number of each carrier's
    transponders: tuple[str, ...]
    transponder: tuple[int, ...]
    #: (N,) deg in the antenna frame, NaN for a beacon; geodetic places, deg
    station_azimuth_deg: Row
    station_elevation_deg: Row
    station_latitude_deg: Row
    station_longitude_deg: Row
    #: azimuth and elevation of the receiving site, deg; its geodetic place, deg, deg, m
    site_deg: tuple[float, float]
    site_position: tuple[float, float, float]
    #: East longitude from which motion is counted, deg
    nominal_longitude_deg: float
    #: (N,) dBm at zero attitude and zero motion
    level_dbm: Row
    #: (N, D)
    daily: Table
    #: (N, 2) dB/deg, azimuth and elevation
    gradient: Table
    #: (N, 3) dB/deg^2, az az, az el, el el
    hessian: Table
    #: (R, 2) dB/deg at the receiving site
    downlink: Table
    #: (N, K, K) of level, daily, gradient, Hessian
    covariance: tuple[Table, ...]
    #: (2 R, 2 R) dB^2/deg^2
    downlink_covariance: Table
    #: (N, K, 2 R)
    downlink_gain: tuple[Table, ...]
    #: (N, 2) dB, cosine and sine of the solar day, counted from midnight UTC
    solar_day_db: Table
    #: (N,) dB, step of the power readings, 0 = none seen
    quantisation_db: Row
    #: (N,) dB per square root of hour
    reference_walk_db: Row
    #: noise that all carriers share
    common_noise: tuple[NoiseComponent, ...]
    #: (N,) whether the robust method uses the carrier
    is_used: tuple[bool, ...]
    #: (N,) number of the group whose level control couples the carrier, -1 = none; empty = no carrier is coupled.
    #: Only differences within a group are known: subtract from each row's deviations the mean over the group's present
    #: carriers, and from the model's gradients the same mean
    alc_group: tuple[int, ...] = ()
    #: (N,) dB, rms over the orbit of the quiet days of what the covariance of ``daily`` alone leaves open
    daily_error_db: Row = ()
