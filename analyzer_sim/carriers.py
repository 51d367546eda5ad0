"""Carrier plans: which station radiates which carrier through which beam, and where it lies in the analyzer's span.

Of the sixteen carriers of `ku16` five are dominant in roll, six have at least twice as much pitch as roll, and four
have their largest figure in yaw scaled by eight. Twice the others, as the rule of the method asks, scaled yaw can
never be: with gradients p along pitch and r along roll the geometry gives 8 yaw = 8 (el p - az r), at most 1.2 |p| +
0.75 |r|. One user has an unstable level (c08), one sits on the curved top of its beam (c12). `python -m
analyzer_sim.structure` prints the table.
"""

from dataclasses import dataclass

from analyzer_sim.beams import Beam, Ripple

#: signal bandwidth over symbol rate is one plus this
ROLLOFF = 0.25
#: uplink and downlink of the first carrier's band, Hz
UPLINK_BASE_HZ = 14_036e6
DOWNLINK_BASE_HZ = 11_486e6


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

    @property
    def bandwidth_hz(self) -> float:
        """Occupied bandwidth, Hz."""
        return self.symbol_rate_hz * (1.0 + ROLLOFF)


@dataclass(frozen=True, slots=True)
class CarrierPlan:
    """The carriers with what they pass through."""

    name: str
    #: beam of each transponder
    beams: dict[str, Beam]
    carriers: tuple[Carrier, ...]
    receiving_site: Station
    #: common gain of the downlink beam around the receiving site
    downlink_beam: Beam
    span_hz: tuple[float, float] = (954e6, 990e6)
    noise_windows_hz: tuple[tuple[float, float], ...] = ((954.05e6, 954.75e6), (971.7e6, 972.3e6), (989.25e6, 989.95e6))
    #: noise density at the analyzer input in clear sky, dBm/Hz
    noise_dbm_hz: float = -120.0


def _ripples(number: int) -> tuple[Ripple, Ripple]:
    return Ripple(0.05, 1.9, 1.1, 0.4 + number), Ripple(0.03, -1.2, 2.6, 0.9 + 1.3 * number)


_BEAMS = {
    "Ku1": Beam("West", -3.07, 6.81, 1.20, 2.60, 0.0, _ripples(0)),
    "Ku2": Beam("Urals", -2.42, 8.60, 1.52, 2.20, -0.25, _ripples(1)),
    "Ku3": Beam("Siberia", 0.07, 8.60, 1.32, 2.34, 0.04, _ripples(2)),
    "Ku4": Beam("East", 3.73, 6.90, 1.20, 2.47, 0.25, _ripples(3)),
}

# station, latitude, longitude, transponder, symbol rate kHz, level dBm, dish width deg, white dB, wander dB
_ROWS = (
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


def _ku16() -> CarrierPlan:
    """Build the default plan."""
    centers_hz = _centers_hz([row[4] * 1e3 for row in _ROWS])
    carriers = tuple(
        Carrier(
            id=f"c{number:02d}",
            station=Station(row[0], row[1], row[2]),
            transponder=row[3],
            center_hz=center_hz,
            symbol_rate_hz=row[4] * 1e3,
            level_dbm=row[5],
            dish_width_deg=row[6],
            white_db=row[7],
            wander_db=row[8],
            polarization="H" if row[3] in {"Ku1", "Ku3"} else "V",
        )
        for number, (row, center_hz) in enumerate(zip(_ROWS, centers_hz, strict=True))
    )
    site = Station("Shchyolkovo", 55.92, 38.00, 160.0)
    downlink = Beam("downlink", -3.60, 7.10, 0.15, 0.25, 0.02, (Ripple(0.04, 1.3, 1.7, 0.6),))
    return CarrierPlan("ku16", dict(_BEAMS), carriers, site, downlink)


#: all plans by name
PLANS: dict[str, CarrierPlan] = {"ku16": _ku16()}
