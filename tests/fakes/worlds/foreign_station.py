"""A ground station of another maker: its files of one geostationary satellite, by geometry of its own.

Nothing of the product or of its simulator is used. A spherical Earth with its oblateness in latitude, a satellite that
stands still but for a small inclination, beams as quadratic forms of the direction, a dish that the satellite drifts
through, noise; then the files: powers with semicolons, decimal commas, local time and dBW, elements of the orbit, a
star tracker's table, a spacecraft and carriers as a spreadsheet.
"""

import csv
import json
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

from foreign_orbits import elements, tle

LONGITUDE_DEG, INCLINATION_DEG = 90.0, 0.05
ZONE, TRACKER_ZONE = "Asia/Yekaterinburg", "UTC"
FIRST = datetime(2026, 10, 5, tzinfo=UTC)
QUIET_DAYS, HOURS_AFTER = 3, 2
_ORBIT_KM, _EARTH_KM = 42_164.2, 6_378.1
#: name, latitude, longitude
STATIONS = (
    ("Moskva", 55.75, 37.62),
    ("Murmansk", 68.97, 33.08),
    ("Rostov", 47.23, 39.72),
    ("Kazan", 55.79, 49.12),
    ("Ekaterinburg", 56.84, 60.61),
    ("Salekhard", 66.53, 66.60),
    ("Omsk", 54.99, 73.37),
    ("Novosibirsk", 55.03, 82.92),
    ("Norilsk", 69.35, 88.20),
    ("Kyzyl", 51.72, 94.44),
    ("Irkutsk", 52.29, 104.28),
    ("Chita", 52.03, 113.50),
    ("Yakutsk", 62.03, 129.73),
    ("Vladivostok", 43.12, 131.89),
    ("Khabarovsk", 48.48, 135.07),
    ("Magadan", 59.56, 150.80),
)
SITE = {"name": "Dubna", "latitude_deg": 56.74, "longitude_deg": 37.17, "height_m": 130.0}
#: centre of the beam, azimuth and elevation, deg, and its half-width, deg
_BEAMS = {"Ku1": (-3.0, 6.6, 2.2), "Ku2": (0.8, 6.9, 2.0), "Ku3": (4.0, 6.4, 2.2)}
_NOISE_DB = 0.05


@dataclass(frozen=True)
class Row:
    """One minute of the station."""

    epoch: datetime
    #: yaw, roll, pitch, deg
    attitude_deg: tuple[float, float, float]
    levels_dbm: list[float]


def direction_deg(latitude_deg: float, longitude_deg: float, satellite: tuple[float, float]) -> tuple[float, float]:
    """Return East and North angles of a place, seen from a satellite over a latitude and longitude, deg."""
    east = math.radians(longitude_deg - satellite[1])
    flattened = math.atan((1 - 1 / 298.257) ** 2 * math.tan(math.radians(latitude_deg)))
    towards = _EARTH_KM * math.cos(flattened) * math.cos(east)
    across = _EARTH_KM * math.cos(flattened) * math.sin(east)
    up = _EARTH_KM * math.sin(flattened) - _ORBIT_KM * math.sin(math.radians(satellite[0]))
    distance = _ORBIT_KM - towards
    return math.degrees(math.atan2(across, distance)), math.degrees(math.atan2(up, distance))


def schedule() -> list[tuple[float, tuple[float, float, float]]]:
    """Return minutes and attitude of the turns: each axis to both sides in steps, then corners."""
    steps: list[tuple[float, tuple[float, float, float]]] = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            for size in (0.15, 0.3, 0.45):
                angles = [0.0, 0.0, 0.0]
                angles[axis] = sign * size
                steps.append((18.0, (angles[0], angles[1], angles[2])))
            steps.append((10.0, (0.0, 0.0, 0.0)))
    for y, r, p in ((1, 1, 1), (1, 1, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1), (-1, -1, -1), (-1, 1, -1), (-1, 1, 1)):
        steps.append((12.0, (0.3 * y, 0.3 * r, 0.3 * p)))
    return [*steps, (10.0, (0.0, 0.0, 0.0))]


def flown() -> Iterator[tuple[datetime, tuple[float, float, float]]]:
    """Yield minutes and attitudes: quiet days, turns with slews of three minutes, hours of ordinary keeping."""
    turns = schedule()
    length = sum(minutes for minutes, _ in turns)
    begin = QUIET_DAYS * 1440
    for minute in range(begin + int(length) + HOURS_AFTER * 60):
        phase = 2 * math.pi * minute / 1436.0
        keeping = (0.05 * math.sin(0.7 * phase), 0.02 * math.sin(2.1 * phase), 0.02 * math.cos(1.6 * phase))
        turned = (0.0, 0.0, 0.0)
        left, former = float(minute - begin), (0.0, 0.0, 0.0)
        for minutes, wanted in turns if left >= 0.0 else ():
            if left < minutes:
                share = min(left / 3.0, 1.0)
                turned = tuple(a + share * (b - a) for a, b in zip(former, wanted, strict=True))  # type: ignore[assignment]
                break
            left, former = left - minutes, wanted
        yaw, roll, pitch = (a + b for a, b in zip(keeping, turned, strict=True))
        yield FIRST + timedelta(minutes=minute), (yaw, roll, pitch)


def rows(seed: int = 7) -> list[Row]:
    """Return the minutes of the station."""
    draw = random.Random(seed)
    beams = [list(_BEAMS)[k * len(_BEAMS) // len(STATIONS)] for k in range(len(STATIONS))]
    nominal = [direction_deg(latitude, longitude, (0.0, LONGITUDE_DEG)) for _, latitude, longitude in STATIONS]
    bases = [draw.uniform(-52.0, -42.0) for _ in STATIONS]
    dishes = [(draw.gauss(0.0, 2.0), draw.gauss(0.0, 2.0)) for _ in STATIONS]
    found = []
    for epoch, attitude in flown():
        turn = 2 * math.pi * (epoch - FIRST).total_seconds() / 86_164.1
        latitude, drift = INCLINATION_DEG * math.sin(turn), 0.002 * math.sin(2 * turn)
        levels = []
        for k, (az, el) in enumerate(nominal):
            yaw, roll, pitch = attitude
            seen_az = az - pitch - math.radians(yaw) * el - drift * 0.15
            seen_el = el - roll + math.radians(yaw) * az - latitude * 0.15
            centre_az, centre_el, width = _BEAMS[beams[k]]
            away2 = ((seen_az - centre_az) / width) ** 2 + ((seen_el - centre_el) / width) ** 2
            daily = dishes[k][0] * latitude + dishes[k][1] * drift
            levels.append(bases[k] - 3.0 * away2 + daily + draw.gauss(0.0, _NOISE_DB))
        found.append(Row(epoch, attitude, levels))
    return found


def channel(number: int) -> str:
    """Return the name that the station's program gives a carrier."""
    return f"Ch{number + 1:02d}"


def write_station(folder: Path, seed: int = 7, minutes: int | None = None) -> list[Row]:
    """Write all files of the station, of the first minutes or all, and return what is true."""
    known = rows(seed)[:minutes]
    write_powers(folder / "pegel.csv", known)
    write_tracker(folder / "star-tracker.csv", known, seed)
    write_orbit(folder / "yamal.tle")
    write_spacecraft(folder / "satellite.csv")
    write_carriers(folder / "carriers.csv")
    return known


def write_powers(path: Path, known: list[Row]) -> None:
    """Write levels in dBW, with decimal commas, in local time, by day and month."""
    zone = ZoneInfo(ZONE)
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        table = csv.writer(file, delimiter=";")
        table.writerow(["Datum", "Zeit", *(channel(k) for k in range(len(STATIONS)))])
        for row in known:
            local = row.epoch.astimezone(zone)
            levels = (f"{level - 30.0:.3f}".replace(".", ",") for level in row.levels_dbm)
            table.writerow([local.strftime("%d.%m.%Y"), local.strftime("%H:%M:%S"), *levels])


def write_tracker(path: Path, known: list[Row], seed: int, signs: tuple[int, int, int] = (1, 1, 1)) -> None:
    """Write the star tracker's angles, deg; a sensor that is mounted wrongly flips signs."""
    draw = random.Random(seed + 1)
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["Time", "Yaw (deg)", "Roll (deg)", "Pitch (deg)"])
        for row in known:
            angles = (s * a + draw.gauss(0.0, 0.005) for s, a in zip(signs, row.attitude_deg, strict=True))
            table.writerow([row.epoch.strftime("%Y-%m-%d %H:%M:%S"), *(f"{angle:.5f}" for angle in angles)])


def write_orbit(path: Path, longitude_deg: float = LONGITUDE_DEG) -> None:
    """Write two-line elements with a name."""
    members = elements(longitude_deg, FIRST) | {"INCLINATION": f"{INCLINATION_DEG:.4f}", "ECCENTRICITY": "0.0000100"}
    path.write_text("\n".join(["YAMAL 202", *tle(members)]) + "\n")


def write_spacecraft(path: Path) -> None:
    """Write a spacecraft as fields and values."""
    fields = {
        "id": "yamal-202",
        "name": "Yamal-202",
        "cospar_id": "2003-053F",
        "longitude_deg": LONGITUDE_DEG,
        **{f"receiving_site.{name}": value for name, value in SITE.items()},
        "inertia_kg_m2": json.dumps([[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]]),
        "torque_limit_n_m": 0.05,
        "onboard.fast_loop": "true",
        "onboard.forecast_mode": "true",
        "onboard.roll_yaw_coupling": "true",
        "onboard.residual_torque_n_m": 0.0,
    }
    lines = [f"{name};{value}" for name, value in fields.items()]
    path.write_text("\n".join(["field;value", *lines]) + "\n")


def write_carriers(path: Path, *, is_exchanged: bool = False) -> None:
    """Write the carriers as a spreadsheet; the station's program knows them by their names."""
    beams = list(_BEAMS)
    header = "id;name;station_name;station_latitude_deg;station_longitude_deg;band;transponder;uplink_hz;downlink_hz"
    lines = [header + ";bandwidth_hz;uplink_power_control;transponder_mode"]
    for k, (name, latitude, longitude) in enumerate(STATIONS):
        uplink_hz = 14_000_000_000 + 5_000_000 * k
        beam = beams[k * len(beams) // len(STATIONS)]
        one, other = (longitude, latitude) if is_exchanged else (latitude, longitude)
        place = f"c{k:02d};{channel(k)};{name};{one};{other};Ku;{beam}"
        lines.append(f"{place};{uplink_hz};{uplink_hz - 2_550_000_000};1250000;none;fixed_gain")
    path.write_text("\n".join(lines) + "\n")
