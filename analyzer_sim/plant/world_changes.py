"""Changes of a flown world for a time: rain over the receiving site, a carrier that changes, wheels that reverse.

Words of a line of the change port:

    {"change":"rain|step|dead-carrier|sign","duration_s":..,["carrier":..]}
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

from analyzer_sim.emission import Emission, Signal
from analyzer_sim.epochs import US_PER_S

#: attenuation of all carriers by rain over the receiving site, rise of the noise density, and step of one carrier, dB
RAIN_DB, RAIN_NOISE_DB, STEP_DB = 6.0, 2.0, 3.0
MAX_DURATION_S = 86_400.0
MAX_LINE_BYTES = 4096


class ChangeError(ValueError):
    """A line holds no change that can be made; the text gives the reason."""


class ChangeKind(StrEnum):
    """Kinds of changes."""

    RAIN = "rain"
    STEP = "step"
    DEAD_CARRIER = "dead-carrier"
    SIGN = "sign"


#: those that concern one carrier
_OF_CARRIER = (ChangeKind.STEP, ChangeKind.DEAD_CARRIER)


class WorldChange(NamedTuple):
    """A change from one instant, exclusive, to another, inclusive, microseconds UTC."""

    kind: ChangeKind
    start_us: int
    stop_us: int
    #: empty = it concerns no single carrier
    carrier: str = ""

    def is_active(self, epoch_us: int) -> bool:
        """Tell whether it acts at an epoch."""
        return self.start_us < epoch_us <= self.stop_us


def parse_change(text: str, epoch_us: int, carriers: Sequence[str]) -> WorldChange:
    """Return the change of a line that begins after an epoch.

    Raises
    ------
    ChangeError
        Not JSON, an unknown kind or carrier, no duration or one beyond a day.
    """
    try:
        message = json.loads(text, parse_int=float)
        kind, duration_s = ChangeKind(message["change"]), message["duration_s"]
        carrier = message.get("carrier", carriers[0] if kind in _OF_CARRIER else "")
    except (ValueError, RecursionError, TypeError, KeyError, AttributeError):
        known = ", ".join(ChangeKind)
        raise ChangeError(f'a line is {{"change":KIND,"duration_s":..,["carrier":..]}}, KIND of {known}') from None
    if not isinstance(duration_s, float) or not 0.0 < duration_s <= MAX_DURATION_S:
        raise ChangeError(f"duration_s lies outside 0..{MAX_DURATION_S:g}")
    if kind in _OF_CARRIER and carrier not in carriers:
        raise ChangeError(f"there is no carrier {str(carrier)[:40]!r}; the carriers are {', '.join(carriers)}")
    if kind not in _OF_CARRIER and carrier:
        raise ChangeError(f"{kind} concerns no single carrier: leave the carrier out")
    return WorldChange(kind, epoch_us, epoch_us + round(duration_s * US_PER_S), carrier)


def changed_emission(emission: Emission, changes: Iterable[WorldChange]) -> Emission:
    """Return an emission with the changes that act at its epoch; the reversed wheels change nothing that arrives."""
    for change in changes:
        if not change.is_active(emission.epoch_us):
            continue
        if change.kind is ChangeKind.RAIN:
            signals = tuple(_shifted(signal, -RAIN_DB) for signal in emission.signals)
            emission = replace(emission, signals=signals, noise_dbm_hz=emission.noise_dbm_hz + RAIN_NOISE_DB)
        elif change.kind is ChangeKind.STEP:
            signals = tuple(
                _shifted(signal, STEP_DB) if signal.carrier == change.carrier else signal for signal in emission.signals
            )
            emission = replace(emission, signals=signals)
        elif change.kind is ChangeKind.DEAD_CARRIER:
            signals = tuple(signal for signal in emission.signals if signal.carrier != change.carrier)
            emission = replace(emission, signals=signals)
    return emission


def response_factor(changes: Iterable[WorldChange], epoch_us: int) -> float:
    """Return what a commanded torque does on the way to an epoch: 1 = what it says, -1 = the opposite."""
    is_reversed = any(change.kind is ChangeKind.SIGN and change.is_active(epoch_us) for change in changes)
    return -1.0 if is_reversed else 1.0


def _shifted(signal: Signal, change_db: float) -> Signal:
    return replace(signal, power_dbm=signal.power_dbm + change_db)
