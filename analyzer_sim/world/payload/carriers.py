"""Carrier plans: which station radiates which carrier through which beam, and where it lies in the analyzer's span.

A beacon is an unmodulated line of the satellite itself: no station, no uplink beam, no symbol rate.

Of the sixteen carriers of `ku16` five are dominant in roll, six have at least twice as much pitch as roll, and four
have their largest figure in yaw scaled by eight. Twice the others, as the rule of the method asks, scaled yaw can
never be: with gradients p along pitch and r along roll the geometry gives 8 yaw = 8 (el p - az r), at most 1.2 |p| +
0.75 |r|. One user has an unstable level (c08), one sits on the curved top of its beam (c12). `python -m
analyzer_sim.world.structure` prints the table.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.payload.beams import Beam, Ripple
from analyzer_sim.world.payload.carrier_rows import C8, KU16, KU_MORE, Row

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
