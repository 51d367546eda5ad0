"""A world in which nothing changes but the time: five carriers of known level, for judging what is measured of them."""

import json
import math
from dataclasses import replace
from itertools import count
from typing import Any

from analyzer_sim.emission import Emission, Signal
from service.frontend.measurement_task import MeasurementTask, parse_task

NOISE_DBM_HZ = -120.0
NOISE = [[954.1e6, 954.9e6], [989.0e6, 989.9e6]]
#: centre MHz, symbol rate Hz, dBm: strong, with a neighbour 6 dB stronger, at C/N 3 dB, a beacon
CARRIERS = {
    "strong": (960.0e6, 1.0e6, -42.9),
    "beside": (965.0e6, 1.0e6, -50.0),
    "louder": (966.32e6, 1.0e6, -44.0),
    "weak": (972.0e6, 1.2e6, NOISE_DBM_HZ + 10 * math.log10(1.2e6) + 3.0),
    "beacon": (980.0e6, 0.0, -65.0),
}


class Steady:
    """Source of the carriers."""

    def __init__(self) -> None:
        signals = tuple(Signal(name, centre, rate, 0.25, level) for name, (centre, rate, level) in CARRIERS.items())
        self.emission = Emission(0, signals, NOISE_DBM_HZ)
        self.epochs = count(1_793_491_200_000_000, 60_000_000)

    def advance(self) -> Emission:
        self.emission = replace(self.emission, epoch_us=next(self.epochs))
        return self.emission

    def current(self) -> Emission:
        return self.emission

    def switch_off(self, name: str) -> None:
        """Take a carrier off the air."""
        kept = tuple(signal for signal in self.emission.signals if signal.carrier != name)
        self.emission = replace(self.emission, signals=kept)


def steady_task(*, time_s: float = 1.0, **analyzer: Any) -> MeasurementTask:
    """Return the task of these carriers: one sweep of 36 MHz."""
    sweep = {"id": "a", "start_hz": 954e6, "stop_hz": 990e6, "rbw_hz": 30e3, "points": 2401, "time_s": time_s}
    carriers = [
        {"id": name, "sweep": "a", "fc_hz": centre, "noise": NOISE}
        | (
            {"symbol_rate": rate, "integ_bw_hz": 1.25 * rate, "kind": "modulated"}
            if rate
            else {"integ_bw_hz": 300e3, "kind": "beacon"}
        )
        for name, (centre, rate, _) in CARRIERS.items()
    ]
    document = {
        "task": {"id": "t", "analyzer": analyzer},
        "input": {"ref_level_dbm": -20.0, "attenuation_db": 10.0, "preamp": False},
        "sweeps": [sweep],
        "carriers": carriers,
    }
    return parse_task(json.dumps(document).encode())[0]
