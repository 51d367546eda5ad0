"""Carrier plans: which station radiates which carrier through which beam, and where it lies in the analyzer's span."""

from dataclasses import dataclass, field, replace

import numpy as np

from analyzer_sim.epochs import US_PER_H
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.scenario.events import PlanChange
from analyzer_sim.world.scenario.story import Scenario


@dataclass(frozen=True, slots=True)
class Ripple:
    """One wave of the shaped pattern."""

    #: amplitude, dB
    amplitude_db: float
    #: wave numbers along azimuth and elevation, rad/deg
    azimuth_rad_deg: float
    elevation_rad_deg: float
    #: phase at the centre, rad
    phase_rad: float


@dataclass(frozen=True, slots=True)
class Beam:
    """One shaped beam of the satellite."""

    name: str
    #: centre in the antenna frame, deg
    azimuth_deg: float
    elevation_deg: float
    #: curvatures, dB/deg^2, positive = falling away from the centre
    azimuth_curvature: float = 1.5
    elevation_curvature: float = 2.7
    cross_curvature: float = 0.0
    ripples: tuple[Ripple, ...] = ()

    def gain_db(self, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
        """Return the gain relative to the centre, dB, for any shape of angles."""
        u = azimuth_deg - self.azimuth_deg
        v = elevation_deg - self.elevation_deg
        gain = (
            -0.5 * self.azimuth_curvature * u**2 - 0.5 * self.elevation_curvature * v**2 + self.cross_curvature * u * v
        )
        for wave in self.ripples:
            phase = wave.azimuth_rad_deg * u + wave.elevation_rad_deg * v + wave.phase_rad
            gain = gain + wave.amplitude_db * np.cos(phase)
        return np.asarray(gain)


Row = tuple[str, float, float, str, int, float, float, float, float]

#: four users on each of four transponders
KU16: tuple[Row, ...] = (
    ("Rostov-on-Don", 47.23, 39.72, "Ku1", 1000, -42.9, 0.62, 0.150, 0.0),
    ("Saint Petersburg", 59.94, 30.31, "Ku1", 1200, -42.4, 0.36, 0.140, 0.0),
    ("Kaliningrad", 54.71, 20.51, "Ku1", 720, -43.5, 0.88, 0.155, 0.0),
    ("Moscow", 55.75, 37.62, "Ku1", 1200, -42.2, 0.31, 0.135, 0.0),
    ("Yekaterinburg", 56.84, 60.61, "Ku2", 1000, -42.8, 0.48, 0.150, 0.0),
    ("Vorkuta", 67.50, 64.05, "Ku2", 640, -43.8, 0.95, 0.165, 0.0),
    ("Omsk", 54.99, 73.37, "Ku2", 880, -43.1, 0.55, 0.150, 0.0),
    ("Tyumen", 57.15, 65.53, "Ku2", 1120, -42.6, 0.33, 0.145, 0.0),
    ("Krasnoyarsk", 56.01, 92.87, "Ku3", 800, -43.2, 0.72, 0.160, 0.30),
    ("Gorno-Altaysk", 51.96, 85.96, "Ku3", 560, -43.9, 0.90, 0.165, 0.0),
    ("Tiksi", 71.64, 128.87, "Ku3", 640, -43.6, 0.78, 0.165, 0.0),
    ("Kyzyl", 51.72, 94.44, "Ku3", 1120, -42.7, 0.42, 0.140, 0.0),
    ("Blagoveshchensk", 50.27, 127.54, "Ku4", 960, -43.0, 0.40, 0.150, 0.0),
    ("Yuzhno-Sakhalinsk", 46.96, 142.73, "Ku4", 720, -43.4, 0.65, 0.160, 0.0),
    ("Petropavlovsk-Kamchatsky", 53.02, 158.65, "Ku4", 640, -43.7, 0.82, 0.165, 0.0),
    ("Khabarovsk", 48.48, 135.07, "Ku4", 1200, -42.5, 0.32, 0.140, 0.0),
)

#: sixteen users more; two of them take the places of carriers that leave the plan
KU_MORE: tuple[Row, ...] = (
    ("Petrozavodsk", 61.79, 34.36, "Ku1", 560, -43.9, 0.85, 0.160, 0.0),
    ("Krasnodar", 45.04, 38.98, "Ku1", 640, -43.4, 0.58, 0.155, 0.0),
    ("Astrakhan", 46.35, 48.04, "Ku1", 640, -43.5, 0.70, 0.155, 0.0),
    ("Saratov", 51.53, 46.03, "Ku1", 720, -43.2, 0.45, 0.150, 0.0),
    ("Kurgan", 55.44, 65.34, "Ku2", 640, -43.3, 0.40, 0.150, 0.0),
    ("Khanty-Mansiysk", 61.00, 69.02, "Ku2", 640, -43.6, 0.66, 0.160, 0.0),
    ("Salekhard", 66.53, 66.60, "Ku2", 560, -43.8, 0.90, 0.165, 0.0),
    ("Tobolsk", 58.20, 68.25, "Ku2", 720, -43.1, 0.52, 0.150, 0.0),
    ("Novosibirsk", 55.03, 82.92, "Ku3", 720, -43.0, 0.38, 0.145, 0.0),
    ("Norilsk", 69.35, 88.20, "Ku3", 560, -43.9, 0.92, 0.165, 0.0),
    ("Abakan", 53.72, 91.44, "Ku3", 720, -43.2, 0.50, 0.150, 0.0),
    ("Tomsk", 56.50, 84.97, "Ku3", 640, -43.5, 0.74, 0.160, 0.0),
    ("Vladivostok", 43.12, 131.89, "Ku4", 720, -43.2, 0.44, 0.150, 0.0),
    ("Birobidzhan", 48.79, 132.92, "Ku4", 560, -43.8, 0.86, 0.165, 0.0),
    ("Sovetskaya Gavan", 48.97, 140.28, "Ku4", 640, -43.4, 0.60, 0.155, 0.0),
    ("Komsomolsk-on-Amur", 50.55, 137.01, "Ku4", 640, -43.5, 0.56, 0.155, 0.0),
)

#: users of the C band: wide dishes, weaker beams, levels that rain hardly touches
C8: tuple[Row, ...] = (
    ("Sochi", 43.60, 39.73, "C1", 800, -43.1, 1.30, 0.145, 0.0),
    ("Arkhangelsk", 64.54, 40.54, "C1", 720, -43.4, 1.60, 0.150, 0.0),
    ("Perm", 58.01, 56.25, "C1", 880, -43.0, 1.40, 0.145, 0.0),
    ("Samara", 53.20, 50.15, "C1", 960, -42.8, 1.20, 0.140, 0.0),
    ("Barnaul", 53.35, 83.76, "C2", 800, -43.2, 1.50, 0.150, 0.0),
    ("Dudinka", 69.41, 86.18, "C2", 640, -43.7, 1.80, 0.155, 0.0),
    ("Nakhodka", 42.82, 132.88, "C2", 880, -43.0, 1.30, 0.145, 0.0),
    ("Magadan", 59.56, 150.81, "C2", 640, -43.8, 1.80, 0.160, 0.0),
)


#: signal bandwidth over symbol rate is one plus this
ROLLOFF = 0.25
#: left edge of the analyzer's span, Hz
SPAN_START_HZ = 954e6
#: band in which a beacon's power is integrated, Hz
BEACON_BAND_HZ = 100e3


@dataclass(frozen=True, slots=True)
class Band:
    """A frequency band: where its converted span begins on the air, and how much of the Ku band's rain it feels."""

    name: str
    uplink_base_hz: float
    downlink_base_hz: float
    rain_share: float


#: noise density at the analyzer input in clear sky, dBm/Hz
CLEAR_NOISE_DBM_HZ = -120.0
#: both converters lead to one span
BANDS = {"Ku": Band("Ku", 14_036e6, 11_486e6, 1.0), "C": Band("C", 5_950e6, 3_625e6, 0.1)}


@dataclass(frozen=True, slots=True)
class Station:
    """An earth station of a user, or the receiving site."""

    name: str
    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Carrier:
    """One carrier of the plan."""

    id: str
    station: Station
    transponder: str
    #: centre at the analyzer input, Hz
    center_hz: float
    symbol_rate_hz: float
    #: level at nominal attitude, dBm
    level_dbm: float
    #: half-power width of the user's fixed dish, deg
    dish_width_deg: float
    #: white noise of a row including the sweep's own share, dB
    white_db: float
    #: further slow wander of an unstable user, dB
    wander_db: float = 0.0
    polarization: str = "H"
    band: str = "Ku"
    #: a line of the satellite itself; `station` is then the receiving site
    is_beacon: bool = False

    @property
    def bandwidth_hz(self) -> float:
        """Occupied bandwidth, of a beacon the band of integration, Hz."""
        return BEACON_BAND_HZ if self.is_beacon else self.symbol_rate_hz * (1.0 + ROLLOFF)

    @property
    def c_n0_db_hz(self) -> float:
        """Level over the noise density of the clear sky."""
        return self.level_dbm - CLEAR_NOISE_DBM_HZ


@dataclass(frozen=True, slots=True)
class CarrierPlan:
    """The carriers with what they pass through."""

    name: str
    #: beam of each transponder
    beams: dict[str, Beam]
    carriers: tuple[Carrier, ...]
    receiving_site: Station
    #: gain of the Ku band's downlink beam around the receiving site, common to its carriers
    downlink_beam: Beam
    span_hz: tuple[float, float] = (954e6, 990e6)
    noise_windows_hz: tuple[tuple[float, float], ...] = ((954.05e6, 954.75e6), (971.7e6, 972.3e6), (989.25e6, 989.95e6))
    #: noise density at the analyzer input in clear sky, dBm/Hz
    noise_dbm_hz: float = CLEAR_NOISE_DBM_HZ
    #: downlink beams of other bands by name
    other_downlink_beams: dict[str, Beam] = field(default_factory=dict)

    @property
    def rain_share(self) -> FloatArray:
        """(N,) share of the Ku band's rain that each carrier feels."""
        return np.array([BANDS[carrier.band].rain_share for carrier in self.carriers])

    @property
    def downlink_beams(self) -> dict[str, Beam]:
        """Downlink beam of each band."""
        return {"Ku": self.downlink_beam, **self.other_downlink_beams}

    @property
    def users(self) -> list[int]:
        """Columns of the carriers that come up from stations: all but beacons."""
        return [k for k, carrier in enumerate(self.carriers) if not carrier.is_beacon]

    @property
    def columns_by_station(self) -> dict[str, list[int]]:
        """Columns of the users' carriers by name of the station."""
        columns: dict[str, list[int]] = {}
        for k in self.users:
            columns.setdefault(self.carriers[k].station.name, []).append(k)
        return columns

    def column(self, carrier_id: str) -> int:
        """Return the column of a carrier."""
        return [carrier.id for carrier in self.carriers].index(carrier_id)


def _ripples(number: int) -> tuple[Ripple, Ripple]:
    return Ripple(0.05, 1.9, 1.1, 0.4 + number), Ripple(0.03, -1.2, 2.6, 0.9 + 1.3 * number)


_BEAMS = {
    "Ku1": Beam("West", -3.07, 6.81, 1.20, 2.60, 0.0, _ripples(0)),
    "Ku2": Beam("Urals", -2.42, 8.60, 1.52, 2.20, -0.25, _ripples(1)),
    "Ku3": Beam("Siberia", 0.07, 8.60, 1.32, 2.34, 0.04, _ripples(2)),
    "Ku4": Beam("East", 3.73, 6.90, 1.20, 2.47, 0.25, _ripples(3)),
}

#: left edge of the first carrier and free room beyond it, on each side of the noise window in the middle, Hz
_HALVES = ((955.0e6, 971.4e6), (972.6e6, 989.0e6))


def _centers_hz(symbol_rates_hz: list[float]) -> list[float]:
    """Place carriers from left to right in the two halves of the span with equal guard bands."""
    half = len(symbol_rates_hz) // 2
    centers = []
    for (left_hz, right_hz), rates in zip(_HALVES, (symbol_rates_hz[:half], symbol_rates_hz[half:]), strict=True):
        widths = [rate * (1.0 + ROLLOFF) for rate in rates]
        guard_hz = (right_hz - left_hz - sum(widths)) / (len(widths) + 1)
        edge_hz = left_hz + guard_hz
        for width_hz in widths:
            centers.append(round((edge_hz + width_hz / 2.0) / 1e3) * 1e3)
            edge_hz += width_hz + guard_hz
    return centers


_SITE = Station("Shchyolkovo", 55.92, 38.00, 160.0)
_DOWNLINK = Beam("downlink", -3.60, 7.10, 0.15, 0.25, 0.02, (Ripple(0.04, 1.3, 1.7, 0.6),))
_C_BEAMS = {
    "C1": Beam("C West", -2.90, 7.30, 1.05, 2.10, 0.10, _ripples(4)),
    "C2": Beam("C East", 1.60, 7.35, 0.80, 2.00, -0.05, _ripples(5)),
}
_C_DOWNLINK = Beam("C downlink", -3.10, 7.40, 0.10, 0.18, 0.0, (Ripple(0.03, 1.1, 1.4, 1.9),))
#: transponders of the horizontal polarization
_HORIZONTAL = {"Ku1", "Ku3", "C1"}


def _carrier(carrier_id: str, row: Row, center_hz: float) -> Carrier:
    return Carrier(
        id=carrier_id,
        station=Station(row[0], row[1], row[2]),
        transponder=row[3],
        center_hz=center_hz,
        symbol_rate_hz=row[4] * 1e3,
        level_dbm=row[5],
        dish_width_deg=row[6],
        white_db=row[7],
        wander_db=row[8],
        polarization="H" if row[3] in _HORIZONTAL else "V",
        band="C" if row[3].startswith("C") else "Ku",
    )


def _plan(name: str, rows: tuple[Row, ...], *, rate_share: float = 1.0) -> CarrierPlan:
    """Lay rows out over the span, from left to right in their order."""
    scaled = [(*row[:4], round(row[4] * rate_share), *row[5:]) for row in rows]
    centers_hz = _centers_hz([row[4] * 1e3 for row in scaled])
    carriers = tuple(
        _carrier(f"c{number:02d}", row, center_hz)
        for number, (row, center_hz) in enumerate(zip(scaled, centers_hz, strict=True))
    )
    used = {row[3] for row in rows}
    beams = {transponder: beam for transponder, beam in {**_BEAMS, **_C_BEAMS}.items() if transponder in used}
    others = {"C": _C_DOWNLINK} if used & set(_C_BEAMS) else {}
    return CarrierPlan(name, beams, carriers, _SITE, _DOWNLINK, other_downlink_beams=others)


def _with_successors(plan: CarrierPlan, name: str, successors: dict[str, tuple[str, Row]]) -> CarrierPlan:
    """Add carriers that take over the places of others in the span once those have left it."""
    added = []
    for gone, (carrier_id, row) in successors.items():
        position = plan.carriers[plan.column(gone)]
        rate_khz = min(row[4], round(position.symbol_rate_hz / 1e3))
        added.append(_carrier(carrier_id, (*row[:4], rate_khz, *row[5:]), position.center_hz))
    return replace(plan, name=name, carriers=(*plan.carriers, *added))


def _with_beacons(plan: CarrierPlan, name: str, centers_hz: dict[str, float]) -> CarrierPlan:
    """Add beacons of the Ku band after the users' carriers."""
    beacons = (
        Carrier(
            id=carrier_id,
            station=plan.receiving_site,
            transponder="Ku-beacon",
            center_hz=center_hz,
            symbol_rate_hz=0.0,
            level_dbm=-50.0,
            dish_width_deg=np.inf,
            white_db=0.06,
            is_beacon=True,
        )
        for carrier_id, center_hz in centers_hz.items()
    )
    return replace(plan, name=name, carriers=(*plan.carriers, *beacons))


#: the eight of `ku16` whose bound is nearest the published figure for eight carriers
_KU8 = tuple(KU16[number] for number in (0, 1, 4, 5, 9, 10, 12, 14))
_KU16 = _plan("ku16", KU16)
#: who takes over from whom when the plan changes
SUCCESSORS = {"c06": ("c16", KU_MORE[8]), "c13": ("c17", KU_MORE[12])}

#: all plans by name
PLANS: dict[str, CarrierPlan] = {
    "ku16": _KU16,
    "ku8": _plan("ku8", _KU8),
    "ku32": _plan("ku32", KU16 + KU_MORE, rate_share=0.7),
    "kuc16": _plan("kuc16", _KU8 + C8),
    "ku16_beacons": _with_beacons(_KU16, "ku16_beacons", {"b00": 955.1e6, "b01": 988.9e6}),
    "ku16_changed": _with_successors(_KU16, "ku16_changed", SUCCESSORS),
}


@dataclass(frozen=True, slots=True)
class PlanVersion:
    """The carriers of one published plan."""

    #: epoch from which it holds
    reported_us: int
    carriers: tuple[Carrier, ...]


def plan_versions(scenario: Scenario, plan: CarrierPlan) -> tuple[PlanVersion, ...]:
    """Return every version in order of time; the first holds from the start."""
    changes = sorted((f for f in scenario.faults if isinstance(f, PlanChange)), key=lambda change: change.start_h)
    on_air = {carrier.id for carrier in plan.carriers} - {name for change in changes for name in change.new}
    versions = [_version(scenario.start_us, plan, on_air)]
    for change in changes:
        on_air = (on_air - set(change.gone)) | set(change.new)
        version = _version(scenario.operation_start_us + round(change.start_h * US_PER_H), plan, on_air)
        ordered = version.carriers[::-1] if change.is_order_reversed else version.carriers
        versions.append(PlanVersion(version.reported_us, ordered))
    return tuple(versions)


def _version(reported_us: int, plan: CarrierPlan, on_air: set[str]) -> PlanVersion:
    return PlanVersion(reported_us, tuple(carrier for carrier in plan.carriers if carrier.id in on_air))
