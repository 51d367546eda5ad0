"""Orbits and attitudes as other programs write them: elements in four notations, quaternions in messages and tables."""

import math
from collections.abc import Sequence
from datetime import UTC, datetime

#: rotation of the Earth after the IAU 1982 sidereal time, deg and deg a day
_GMST_J2000_DEG, _GMST_RATE_DEG = 280.46061837, 360.98564736629
_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


def elements(
    longitude_deg: float,
    epoch: datetime = datetime(2026, 3, 1, tzinfo=UTC),
    designator: str = "2003-053F",
    name: str = "YAMAL 202",
) -> dict[str, str]:
    """Return the members of an OMM of a geosynchronous orbit over a longitude."""
    days = (epoch - _J2000).total_seconds() / 86400.0
    raan_deg, pericentre_deg = 80.0, 30.0
    anomaly_deg = (longitude_deg + _GMST_J2000_DEG + _GMST_RATE_DEG * days - raan_deg - pericentre_deg) % 360.0
    return {
        "OBJECT_NAME": name,
        "OBJECT_ID": designator,
        "CENTER_NAME": "EARTH",
        "REF_FRAME": "TEME",
        "TIME_SYSTEM": "UTC",
        "MEAN_ELEMENT_THEORY": "SGP4",
        "EPOCH": epoch.strftime("%Y-%m-%dT%H:%M:%S.%f"),
        "MEAN_MOTION": "1.00270000",
        "ECCENTRICITY": "0.0002000",
        "INCLINATION": "3.0000",
        "RA_OF_ASC_NODE": f"{raan_deg:.4f}",
        "ARG_OF_PERICENTER": f"{pericentre_deg:.4f}",
        "MEAN_ANOMALY": f"{anomaly_deg:.4f}",
        "NORAD_CAT_ID": "28089",
        "BSTAR": "0",
    }


def tle(known: dict[str, str]) -> list[str]:
    """Return the two lines of elements."""
    epoch = datetime.fromisoformat(known["EPOCH"]).replace(tzinfo=UTC)
    day = (epoch - datetime(epoch.year, 1, 1, tzinfo=UTC)).total_seconds() / 86400.0 + 1.0
    designator = known["OBJECT_ID"][2:].replace("-", "")
    angles = [float(known[each]) for each in ("INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY")]
    decimals = known["ECCENTRICITY"].partition(".")[2]
    number = int(known["NORAD_CAT_ID"])
    first = f"1 {number:05d}U {designator:<8} {epoch.year % 100:02d}{day:012.8f}  .00000000  00000-0  00000-0 0  999"
    second = f"2 {number:05d} {angles[0]:8.4f} {angles[1]:8.4f} {decimals} {angles[2]:8.4f} {angles[3]:8.4f} "
    second += f"{float(known['MEAN_MOTION']):11.8f}{1:5d}"
    return [
        f"{line}{sum(int(each) if each.isdigit() else each == '-' for each in line) % 10}" for line in (first, second)
    ]


def omm_kvn(known: dict[str, str]) -> str:
    """Return an OMM, keyword = value."""
    return "\n".join(("CCSDS_OMM_VERS = 2.0", *(f"{name} = {value}" for name, value in known.items()))) + "\n"


def omm_xml(known: dict[str, str]) -> str:
    """Return an OMM in XML."""
    meta = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "MEAN_ELEMENT_THEORY")
    last = ("NORAD_CAT_ID", "BSTAR")

    def members(names: Sequence[str]) -> str:
        return "".join(f"<{name}>{known[name]}</{name}>" for name in names)

    mean = [name for name in known if name not in (*meta, *last)]
    return (
        "<ndm><omm><body><segment>"
        f"<metadata>{members(meta)}</metadata><data><meanElements>{members(mean)}</meanElements>"
        f"<tleParameters>{members(last)}</tleParameters></data></segment></body></omm></ndm>"
    )


def quaternion(yaw_deg: float, roll_deg: float, pitch_deg: float) -> tuple[float, float, float, float]:
    """Return the quaternion, scalar last, of turns about z by yaw, then y by pitch, then x by roll."""
    (cy, sy), (cp, sp), (cr, sr) = (
        (math.cos(math.radians(each) / 2), math.sin(math.radians(each) / 2)) for each in (yaw_deg, pitch_deg, roll_deg)
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def attitude_message(
    rows: Sequence[tuple[datetime, Sequence[float]]],
    frames: tuple[str, str] = ("LVLH_ROTATING", "SC_BODY_1"),
    scalar: str | None = None,
    direction: str | None = None,
) -> str:
    """Return an AEM with quaternions as given; scalar and direction stand in the metadata where they are stated."""
    extra = [f"QUATERNION_TYPE = {scalar}"] if scalar else []
    extra += [f"ATTITUDE_DIR = {direction}"] if direction else []
    lines = [f"{epoch:%Y-%m-%dT%H:%M:%S} {' '.join(f'{part:.12f}' for part in parts)}" for epoch, parts in rows]
    head = ["CCSDS_AEM_VERS = 1.0", "CREATION_DATE = 2026-03-02T00:00:00", "ORIGINATOR = X", "META_START"]
    meta = ["OBJECT_NAME = Y", "OBJECT_ID = 2003-053F", f"REF_FRAME_A = {frames[0]}", f"REF_FRAME_B = {frames[1]}"]
    meta += ["TIME_SYSTEM = UTC", "ATTITUDE_TYPE = QUATERNION", *extra]
    return "\n".join((*head, *meta, "META_STOP", "DATA_START", *lines, "DATA_STOP")) + "\n"
