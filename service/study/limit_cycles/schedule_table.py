"""T6: torque schedules."""

import math

import numpy as np

from service.core.flexible.schedule import FREQUENCY_COUNT, FREQUENCY_REACH, TorquePulse, schedule_response
from service.core.flexible.spacecraft import HubMode
from service.study.limit_cycles import reference
from service.study.limit_cycles.comparison import Compared, ComparedTable


def schedules() -> dict[str, tuple[TorquePulse, ...]]:
    """Return the schedules of T6 by name."""
    _, (omega, xi, _), torque, width = reference.SCHEDULE_AXIS
    period_s = 2.0 * math.pi / omega
    half_s = math.pi / (omega * math.sqrt(1.0 - xi * xi))
    intervals = {"ten a period": period_s, "ten a half period": 0.5 * period_s, "ten every 10 s": 10.0}
    made: dict[str, tuple[TorquePulse, ...]] = {"single": (TorquePulse(0.0, width, torque),)}
    made |= {name: tuple(TorquePulse(k * apart, width, torque) for k in range(10)) for name, apart in intervals.items()}
    made["two halves"] = tuple(TorquePulse(k * half_s, width, 0.5 * torque) for k in range(2))
    return made


def schedule_table() -> ComparedTable:
    """Return T6."""
    inertia, mode_numbers, _, _ = reference.SCHEDULE_AXIS
    mode = HubMode(*mode_numbers)
    tried = mode.omega_rad_s * np.linspace(1.0 - FREQUENCY_REACH, 1.0 + FREQUENCY_REACH, FREQUENCY_COUNT)
    rows = []
    for name, pulses in schedules().items():
        nominal = schedule_response(pulses, mode, inertia)
        scanned = schedule_response(pulses, mode, inertia, omega_rad_s=tried)
        found = {
            "peak": nominal.peak_rad[0],
            "residual": nominal.residual_rad[0],
            "scanned peak": scanned.peak_rad.max(),
            "scanned residual": scanned.residual_rad.max(),
        }
        # the residual of two halves is printed with five digits
        rows += [
            Compared(name, f"{figure}, rad", printed, float(found[figure]), 1e-6 if "halves" not in name else 4e-5)
            for figure, printed in reference.SCHEDULES[name].items()
        ]
    return ComparedTable("T6", "Torque schedules", tuple(rows))
