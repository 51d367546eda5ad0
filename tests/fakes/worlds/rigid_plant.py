"""A rigid spacecraft over the foreign station: it answers wheel torques, and a torque that nobody states acts.

Nothing of the product or of its simulator is used. Roll and yaw exchange at the orbital rate; what is left of the light
of the Sun is a constant and a daily wave about each axis, in the season of eclipses none in these, and noise of every
row. Powers have white
noise, a coloured part of twenty minutes, a daily one that lasts, and a receiving chain that wanders.
"""

import math
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from foreign_station import FIRST, INCLINATION_DEG, LONGITUDE_DEG, SITE, STATIONS, direction_deg, schedule

#: true inertia about yaw, roll, pitch, kg m^2
INERTIA_KG_M2 = np.array([2600.0, 2600.0, 1400.0])
_TURN_PER_S = 2.0 * math.pi / 86_164.1
_QUIET_H, _ALIGN_MIN, _SUBSTEPS = 72, 30, 6
#: centre of the one beam, azimuth and elevation, and its half-widths, deg: its carriers tell roll and pitch well, and
#: yaw by three hundredths of a decibel a degree
_CENTRE_DEG, _WIDTH_DEG = np.array([0.3, 6.6]), np.array([6.0, 2.2])


@dataclass(frozen=True)
class Torque:
    """Torque on the body from outside, N m; (3,) yaw, roll, pitch."""

    constant: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    white: float = 2e-7
    #: length of the eclipse at the end of each day
    eclipse_h: float = 0.0

    def at(self, day: float, draw: np.random.Generator) -> np.ndarray:
        """Return the torque at a time in days; none of the Sun's light reaches the spacecraft in eclipse."""
        phase = 2.0 * math.pi * day
        lit = 0.0 if (day * 24.0) % 24.0 > 24.0 - self.eclipse_h else 1.0
        wave = self.constant + self.cosine * math.cos(phase) + self.sine * math.sin(phase)
        return lit * wave + self.white * draw.standard_normal(3)


def residual_torque(seed: int, scale: float = 1.0, eclipse_h: float = 0.0) -> Torque:
    """Return a twentieth of the torque of the Sun's light on a large comsat."""
    draw = np.random.default_rng((seed, 1))
    constant, cosine, sine = scale * 5e-7 * draw.standard_normal((3, 3)) * np.array([[1.0], [0.6], [0.6]])
    return Torque(constant, cosine, sine, eclipse_h=eclipse_h)


@dataclass
class RigidPlant:
    """One spacecraft with its story: quiet days, turns, an alignment, then the loop is the ground's."""

    seed: int
    torque: Torque
    #: rows that a command takes to the wheels
    delay_rows: int = 0
    #: hours at which wheels are unloaded undeclared, and the impulse that is left about each axis, N m s
    kicks_h: tuple[float, ...] = ()
    kick_n_m_s: float = 5e-4
    row_s: float = 60.0
    attitude_deg: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rate_deg_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    row: int = 0

    def __post_init__(self) -> None:
        """Draw what does not change."""
        draw = self.draw = np.random.default_rng(self.seed)
        count = len(STATIONS)
        self.nominal_deg = np.array([direction_deg(lat, lon, (0.0, LONGITUDE_DEG)) for _, lat, lon in STATIONS])
        self.base_dbm = draw.uniform(-52.0, -42.0, count)
        self.dish_db_deg = draw.normal(0.0, 2.0, (2, count))
        self.daily_db, self.daily_phase = draw.normal(0.0, 0.04, count), draw.uniform(0.0, 2.0 * math.pi, count)
        self.white_db, self.coloured_db = draw.uniform(0.13, 0.17, count), draw.uniform(0.06, 0.11, count)
        self.coloured = self.coloured_db * draw.standard_normal(count)
        self.chain_db = 0.0
        self.turns = [np.array(angles) for minutes, angles in schedule() for _ in range(int(minutes))]
        self.turns_begin, self.align_begin = _QUIET_H * 60, _QUIET_H * 60 + len(self.turns)
        self.begin = self.align_begin + _ALIGN_MIN
        self.sent: list[np.ndarray] = []

    @property
    def epoch(self) -> datetime:
        """Return the instant of the next row."""
        return FIRST + timedelta(seconds=self.row * self.row_s)

    def powers_dbm(self) -> list[float]:
        """Return the levels of this row as they are measured."""
        day = self.row * self.row_s / 86_400.0
        turn = day * 86_400.0 * _TURN_PER_S
        latitude_deg, drift_deg = INCLINATION_DEG * math.sin(turn), 0.002 * math.sin(2.0 * turn)
        yaw, roll, pitch = self.attitude_deg
        az, el = self.nominal_deg.T
        seen_az = az - pitch - math.radians(yaw) * el - 0.15 * drift_deg
        seen_el = el - roll + math.radians(yaw) * az - 0.15 * latitude_deg
        away2 = (((np.stack([seen_az, seen_el], axis=1) - _CENTRE_DEG) / _WIDTH_DEG) ** 2).sum(axis=1)
        keep = math.exp(-self.row_s / 1200.0)
        noise = self.draw.standard_normal((2, len(self.nominal_deg)))
        self.coloured = keep * self.coloured + math.sqrt(1.0 - keep**2) * self.coloured_db * noise[0]
        self.chain_db += 0.01 * math.sqrt(self.row_s / 3600.0) * self.draw.standard_normal()
        daily = self.daily_db * np.cos(2.0 * math.pi * day + self.daily_phase)
        dish = self.dish_db_deg[0] * latitude_deg + self.dish_db_deg[1] * drift_deg
        levels = self.base_dbm - 3.0 * away2 - 0.1 * away2**2 + dish + daily
        return (levels + self.coloured + self.chain_db + self.white_db * noise[1]).round(2).tolist()

    def prepare(self) -> tuple[datetime, list[float], np.ndarray]:
        """Return a row of quiet days, turns or alignment: epoch, powers, attitude as a star tracker tells it."""
        if self.turns_begin <= self.row < self.align_begin:
            self.attitude_deg = self.turns[self.row - self.turns_begin].copy()
        else:
            pushed = 0.97 * self.attitude_deg + 0.004 * self.draw.standard_normal(3)
            self.attitude_deg = np.clip(pushed, -0.09, 0.09)
        epoch, powers = self.epoch, self.powers_dbm()
        self.row += 1
        return epoch, powers, self.attitude_deg + 0.006 * self.draw.standard_normal(3)

    def fly(self, torque_n_m: np.ndarray) -> tuple[datetime, list[float]]:
        """Return the next row of the closed loop; a torque that was commanded acts for a row, after its delay."""
        self.sent.append(torque_n_m)
        acting = self.sent[-1 - self.delay_rows] if len(self.sent) > self.delay_rows else np.zeros(3)
        hour = (self.row - self.begin) * self.row_s / 3600.0
        pushed = acting + self.torque.at(self.row * self.row_s / 86_400.0, self.draw)
        for kick_h in self.kicks_h:
            if hour <= kick_h < hour + self.row_s / 3600.0:
                sign = self.draw.choice([-1.0, 1.0], 3)
                self.rate_deg_s = self.rate_deg_s + np.degrees(sign * self.kick_n_m_s / INERTIA_KG_M2)
        step_s = self.row_s / _SUBSTEPS
        for _ in range(_SUBSTEPS):
            self.rate_deg_s = self.rate_deg_s + np.degrees(pushed / INERTIA_KG_M2) * step_s
            yaw, roll, _pitch = self.attitude_deg
            exchanged = np.array([-_TURN_PER_S * roll, _TURN_PER_S * yaw, 0.0])
            self.attitude_deg = self.attitude_deg + (self.rate_deg_s + exchanged) * step_s
        epoch, powers = self.epoch, self.powers_dbm()
        self.row += 1
        return epoch, powers

    def nodes(self) -> list[datetime]:
        """Return the ascending nodes of the orbit before the loop begins."""
        return [FIRST + timedelta(seconds=86_164.1 * k) for k in range(_QUIET_H // 24 + 1)]

    def track(self) -> dict[str, Any]:
        """Return place of the satellite, each half hour from the first row on for a week."""
        seconds = np.arange(0.0, 8 * 86_400.0, 1800.0)
        turn = seconds * _TURN_PER_S
        return {
            "epochs": [FIRST + timedelta(seconds=each) for each in seconds.tolist()],
            "latitude_deg": (INCLINATION_DEG * np.sin(turn)).tolist(),
            "longitude_deg": (LONGITUDE_DEG + 0.002 * np.sin(2.0 * turn)).tolist(),
        }


def carriers() -> list[dict[str, Any]]:
    """Return the carriers as the interface takes them."""
    return [
        {
            "id": f"c{k:02d}",
            "name": f"Ch{k:02d}",
            "station": {"name": name, "latitude_deg": latitude, "longitude_deg": longitude},
            "band": "Ku",
            "transponder": f"Ku{k % 4}",
            "uplink_hz": 14.0e9 + 5e6 * k,
            "downlink_hz": 11.45e9 + 5e6 * k,
            "bandwidth_hz": 1.25e6,
        }
        for k, (name, latitude, longitude) in enumerate(STATIONS)
    ]


def spacecraft(identifier: str, stated_n_m: float | None, method: str, inertia_share: float = 1.0) -> dict[str, Any]:
    """Return the catalogue's spacecraft with defaults but for release; its inertia may be wrong by a share."""
    yaw, roll, pitch = (inertia_share * INERTIA_KG_M2).tolist()
    torque = {} if stated_n_m is None else {"residual_torque_n_m": stated_n_m}
    return {
        "id": identifier,
        "name": identifier,
        "cospar_id": "2003-053F",
        "longitude_deg": LONGITUDE_DEG,
        "receiving_site": SITE,
        "inertia_kg_m2": np.diag([roll, pitch, yaw]).tolist(),
        "torque_limit_n_m": 0.05,
        "simulated": True,
        "onboard": {"fast_loop": True, "forecast_mode": True, "roll_yaw_coupling": True, **torque},
        "control": {"method": method, "mode": "ground", "release": "automatic", "period_s": 7200, "damping": 0.9},
    }
