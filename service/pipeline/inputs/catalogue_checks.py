"""Checks of the catalogue against physics and radio practice: places, frequencies, orbit.

Each check returns faults, which refuse a document, or warnings, which go back with it. Ranges of bands hold uplinks and
downlinks of satellite services after the Radio Regulations, Article 5, with the margins of national allotments.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from service.core.geometry.frames import satellite_elevation_deg
from service.errors import FieldError
from service.records.catalogue import Carrier, Ephemeris, Spacecraft

#: below it no radio path exists, refraction of 0.5 deg counted in
HORIZON_DEG = -0.5
#: below it rain, refraction and multipath spoil a level
LOW_DEG = 5.0
GHZ = 1e9
#: any carrier of a satellite, Hz
FREQUENCY_RANGE_HZ = (0.1 * GHZ, 60.0 * GHZ)
#: band -> range of uplinks and downlinks, Hz
BAND_RANGES_HZ = {
    "L": (1.0 * GHZ, 2.0 * GHZ),
    "S": (1.9 * GHZ, 4.0 * GHZ),
    "C": (3.3 * GHZ, 7.3 * GHZ),
    "X": (7.0 * GHZ, 9.0 * GHZ),
    "Ku": (10.0 * GHZ, 18.4 * GHZ),
    "Ka": (17.0 * GHZ, 40.0 * GHZ),
}
_BAND_OF = {name.lower(): name for name in BAND_RANGES_HZ}
SIDEREAL_DAY_S = 86_164.0905
MAX_PERIOD_SHARE = 0.02
MAX_LONGITUDE_DEG = 1.0
_DAY_US = 86_400_000_000
#: samples of a day of track
_SAMPLES = 145


class Position(NamedTuple):
    """An earth station and where it stands in a document."""

    pointer: str
    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0


class CatalogueFindings(NamedTuple):
    """Errors and warnings on positions of the catalogue."""

    faults: list[FieldError]
    warnings: list[FieldError]


def check_positions(positions: Sequence[Position], satellite_longitude_deg: float) -> CatalogueFindings:
    """Return the stations that have the satellite below their horizon, and those that have it low.

    Parameters
    ----------
    positions : sequence of Position
        Earth stations.
    satellite_longitude_deg : float
        Nominal sub-satellite longitude, deg East.
    """
    faults: list[FieldError] = []
    warnings: list[FieldError] = []
    if not positions:
        return CatalogueFindings(faults, warnings)
    latitude_deg, longitude_deg, height_m = np.array([position[1:] for position in positions], dtype=np.float64).T
    elevation_deg = satellite_elevation_deg(longitude_deg, latitude_deg, height_m, satellite_longitude_deg)
    exchanged_deg = satellite_elevation_deg(latitude_deg, longitude_deg, height_m, satellite_longitude_deg)
    is_below = elevation_deg < HORIZON_DEG
    is_cured = (exchanged_deg > 0.0) & (np.abs(longitude_deg) <= 90.0)
    is_exchange_likely = 2 * np.count_nonzero(is_cured & is_below) > np.count_nonzero(is_below)
    for position, elevation in zip(positions, elevation_deg.tolist(), strict=True):
        seen = f"the satellite at {satellite_longitude_deg:g} deg East stands at {elevation:.1f} deg elevation"
        if elevation < HORIZON_DEG:
            where = f" from latitude {position.latitude_deg:g}, longitude {position.longitude_deg:g} deg"
            hint = "; latitude and longitude look exchanged" if is_exchange_likely else ""
            faults.append(FieldError(position.pointer, "station.below_horizon", seen + where + hint))
        elif elevation < LOW_DEG:
            warnings.append(FieldError(position.pointer, "station.low", f"{seen}: its levels scatter"))
    return CatalogueFindings(faults, warnings)


def check_carriers(carriers: Sequence[Carrier], satellite_longitude_deg: float) -> CatalogueFindings:
    """Return the errors and warnings on stations and frequencies of a carrier plan."""
    stations = [
        Position(f"/carriers/{k}/station", carrier.station.latitude_deg, carrier.station.longitude_deg)
        for k, carrier in enumerate(carriers)
        if carrier.station is not None
    ]
    found = check_positions(stations, satellite_longitude_deg)
    found.faults.extend(_frequency_faults(carriers))
    return found


def _frequency_faults(carriers: Sequence[Carrier]) -> Iterator[FieldError]:
    """Yield uplinks and downlinks outside what satellites use, or outside their band."""
    for k, carrier in enumerate(carriers):
        band = _BAND_OF.get(carrier.band.lower())
        for name, frequency_hz in (("uplink_hz", carrier.uplink_hz), ("downlink_hz", carrier.downlink_hz)):
            if frequency_hz is None:
                continue
            low, high = FREQUENCY_RANGE_HZ if band is None else BAND_RANGES_HZ[band]
            if not low <= frequency_hz <= high:
                code = "carrier.frequency" if band is None else "carrier.band"
                whose = "satellites use" if band is None else f"band {band} is"
                detail = f"{name} is {frequency_hz / GHZ:g} GHz, {whose} {low / GHZ:g} to {high / GHZ:g} GHz"
                yield FieldError(f"/carriers/{k}/{name}", code, detail)


#: what satellites of geostationary orbit have: moments of inertia, kg m^2; torque, N m; momentum of a wheel, N m s
_LIKELY_INERTIA_KG_M2 = (50.0, 500_000.0)
_LIKELY_TORQUE_N_M = (1e-3, 5.0)
_LIKELY_MOMENTUM_N_M_S = (0.5, 500.0)
#: carriers from which one transponder for all is odd
_MANY_CARRIERS = 6


def unlikely_body(spacecraft: Spacecraft) -> list[str]:
    """Return figures of a spacecraft outside of what satellites have: a person must confirm them."""
    moments = np.linalg.eigvalsh(np.array(spacecraft.inertia_kg_m2, dtype=np.float64))
    wheels = spacecraft.wheels
    figures = (
        ("/inertia_kg_m2", float(moments[0]), _LIKELY_INERTIA_KG_M2, "kg m^2"),
        ("/inertia_kg_m2", float(moments[-1]), _LIKELY_INERTIA_KG_M2, "kg m^2"),
        ("/torque_limit_n_m", spacecraft.torque_limit_n_m, _LIKELY_TORQUE_N_M, "N m"),
        ("/wheels/torque_limit_n_m", wheels.torque_limit_n_m, _LIKELY_TORQUE_N_M, "N m"),
        ("/wheels/momentum_limit_n_m_s", wheels.momentum_limit_n_m_s, _LIKELY_MOMENTUM_N_M_S, "N m s"),
    )
    return [
        f"{pointer}: {value:g} {unit}; satellites have {low:g} to {high:g} {unit}"
        for pointer, value, (low, high), unit in figures
        if not low <= value <= high
    ]


def unlikely_carriers(carriers: Sequence[Carrier], satellite_longitude_deg: float) -> list[str]:
    """Return what looks exchanged or left out in a plan: a person must confirm it."""
    found = []
    both = [(each.uplink_hz, each.downlink_hz) for each in carriers if each.uplink_hz is not None]
    if both and all(uplink_hz < downlink_hz for uplink_hz, downlink_hz in both):
        detail = "/carriers: every uplink is below its downlink: uplink_hz and downlink_hz look exchanged"
        found.append(detail)
    stations = [each.station for each in carriers if each.station is not None]
    if stations:
        latitude_deg, longitude_deg = np.array([(each.latitude_deg, each.longitude_deg) for each in stations]).T
        seen, mirrored = (
            int(
                np.sum(
                    satellite_elevation_deg(sign * longitude_deg, latitude_deg, 0.0, satellite_longitude_deg) > LOW_DEG
                )
            )
            for sign in (1.0, -1.0)
        )
        if mirrored > seen:
            detail = f"/carriers: {seen} of {len(stations)} stations see the satellite well, {mirrored} with"
            found.append(f"{detail} the sign of the longitudes turned: East is positive")
    if len(carriers) >= _MANY_CARRIERS and len({each.transponder for each in carriers}) == 1:
        whole = f"all {len(carriers)} carriers are on transponder {carriers[0].transponder}"
        found.append(f"/carriers: {whole}: one fault spoils them all")
    return found


def contradiction_of(ephemeris: Ephemeris, satellite_longitude_deg: float) -> str | None:
    """Return in which way an ephemeris contradicts the catalogue, None when it does not.

    Parameters
    ----------
    ephemeris : Ephemeris
        Of any form; without a track only its period is judged.
    satellite_longitude_deg : float
        Nominal sub-satellite longitude, deg East.
    """
    share = abs(ephemeris.nodal_period_s / SIDEREAL_DAY_S - 1.0)
    if share > MAX_PERIOD_SHARE:
        return f"the nodal period is {ephemeris.nodal_period_s:.0f} s, a sidereal day has {SIDEREAL_DAY_S:.0f} s"
    track = ephemeris.track
    if track is None:
        return None
    # elements are propagated for weeks: the day in the middle is the one they are nearest to on all sides
    first_us, last_us = track.epochs_us[0], track.epochs_us[-1]
    middle_us = (first_us + last_us) / 2
    half_us = min(_DAY_US, last_us - first_us) / 2
    epochs_us = np.linspace(middle_us - half_us, middle_us + half_us, _SAMPLES)
    longitude_deg = np.unwrap(np.array(track.longitude_deg), period=360.0)
    mean_deg = float(np.mean(np.interp(epochs_us, track.epochs_us, longitude_deg)))
    apart_deg = (mean_deg - satellite_longitude_deg + 180.0) % 360.0 - 180.0
    if abs(apart_deg) <= MAX_LONGITUDE_DEG:
        return None
    return (
        f"the mean longitude over a day is {mean_deg % 360.0:.2f} deg East, the catalogue has "
        f"{satellite_longitude_deg:g} deg"
    )
