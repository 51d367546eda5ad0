"""State of the measurement functions: markers, channels, which measurement is selected. No command, no trace.

Law of this file: a figure that was never set is absent; the row of its command knows the default. A measurement that
sweeps on its own (Keysight's CHPower, OBWidth, ACPower) keeps its span, filter, time and averages under its own name;
:func:`swept_settings` makes from them the settings its sweeps are taken with.
"""

from dataclasses import dataclass, field, replace

from analyzer_sim.instrument.settings.instrument_settings import Settings
from analyzer_sim.instrument.settings.quantities import store

#: the plain spectrum: sweeps are taken with the settings as they are
SPECTRUM = "SAN"
OFF = "OFF"


@dataclass(slots=True)
class Marker:
    """One marker on the trace."""

    is_on: bool = False
    #: at the input, Hz; ``None`` = it has not been placed and stands at the centre
    frequency_hz: float | None = None
    #: OFF, NOIS (density), BPOW (power in a band) or BDEN (density in a band)
    function: str = OFF
    #: width of the band, Hz; ``None`` = a twentieth of the span
    span_hz: float | None = None
    #: a band marker reads a density where its function does not say so
    is_density: bool = False


@dataclass(slots=True)
class FunctionSettings:
    """Settings of the measurement functions; ``*RST`` restores their defaults."""

    #: numeric settings by name
    figures: dict[str, float] = field(default_factory=dict)
    #: words and switches by name
    words: dict[str, str] = field(default_factory=dict)
    #: markers by number
    markers: dict[int, Marker] = field(default_factory=dict)
    #: measurement selected
    measurement: str = SPECTRUM
    #: whether that measurement sweeps with figures of its own
    is_own_sweep: bool = False

    def marker(self, number: int) -> Marker:
        """Return the marker of this number; it is made when it was never touched."""
        return self.markers.setdefault(number, Marker())

    def select(self, measurement: str, *, is_own_sweep: bool = False) -> None:
        """Select a measurement."""
        self.measurement, self.is_own_sweep = measurement, is_own_sweep

    def forget(self, prefix: str) -> None:
        """Return all figures and words whose names begin so to their defaults."""
        for table in (self.figures, self.words):
            for name in [name for name in table if name.startswith(prefix)]:
                del table[name]


def swept_settings(settings: Settings, functions: FunctionSettings) -> Settings:
    """Return the settings a sweep is taken with: a copy changed by a measurement that sweeps on its own, else as is.

    Such a measurement uses the RMS detector and averages mW; its filter and its time are automatic until they are set.
    """
    if not functions.is_own_sweep:
        return settings
    own = {
        name.removeprefix(f"{functions.measurement}."): value
        for name, value in functions.figures.items()
        if name.startswith(f"{functions.measurement}.")
    }
    swept = replace(settings, detector="RMS", is_averaging=False, is_rbw_auto=True, is_vbw_auto=True, is_time_auto=True)
    store(swept, "span_hz", own.get("span_hz", settings.span_hz))
    is_averaging = functions.words.get(f"{functions.measurement}.averaging", "1") == "1"
    swept.count = round(own.get("averages", 1.0)) if is_averaging else 1
    for name in ("rbw_hz", "time_s"):
        if name in own:
            store(swept, name, own[name])
    return swept
