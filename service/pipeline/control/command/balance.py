"""Balance: torque and rates, which were learned over hours, are commanded against while no angle may be corrected.

Both are slow states of the estimator, which the rows of a fade hardly move. What they would move wrongly is found: the
newest row that control could use is carried on by its own rates, by the torque known then and by what was executed
since, and where the angle that is seen leaves this prediction by four sigma, balance ends. The method `paper` takes no
fix in a fade, so its rows cannot contradict, and `hold_h` alone ends its balance. Order everywhere: yaw, roll, pitch.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from service.core.control.quaternion_law import inertia_about_angles, inverse_of
from service.pipeline.estimation.row_inhibitions import BALANCED
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_ANGLES,
    NO_AXES,
    AttitudeRow,
    Axes,
    BalanceBasis,
    Disturbance,
    FloatArray,
    Pulse,
)

#: sigmas between the angle that is seen and the predicted one
_SIGMAS = 4.0


def basis_of(row: AttitudeRow, disturbance: Disturbance | None) -> BalanceBasis | None:
    """Return what a row that control could use lets be balanced after it; None where nothing is known for it."""
    if row.rates_deg_s is None:
        return None
    return BalanceBasis(
        epoch_us=row.epoch_us,
        axes=row.control_allowed_axes,
        attitude_deg=row.steered_deg,
        sigma_deg=row.steered_sigma_deg,
        rates_deg_s=row.rates_deg_s,
        disturbance=disturbance,
    )


def with_executed(basis: BalanceBasis, pulses: Sequence[Pulse]) -> BalanceBasis:
    """Return a basis after pulses that its row did not know; they replace all older ones from the first of them on."""
    first_us = min((pulse.start_us for pulse in pulses), default=None)
    before = (pulse for pulse in basis.executed if first_us is None or pulse.start_us < first_us)
    return replace(basis, executed=(*before, *pulses))


def basis_at(basis: BalanceBasis, row: AttitudeRow, spacecraft: Spacecraft, hold_s: float) -> BalanceBasis | None:
    """Return a basis as it holds at a row that control may not use; None: it is too old, or the row contradicts it."""
    if row.epoch_us - basis.epoch_us > hold_s * US_PER_S:
        return None
    ahead_s = (row.epoch_us - basis.epoch_us) / US_PER_S
    apart_deg = np.abs(np.array(row.steered_deg) - predicted_deg(basis, row.epoch_us, spacecraft))
    variance_deg2 = np.square(basis.sigma_deg) + np.square(row.steered_sigma_deg)
    if basis.disturbance is not None:
        turned_deg = np.degrees(_inverse_1_kg_m2(spacecraft) @ basis.disturbance.sigma_n_m) * 0.5 * ahead_s**2
        variance_deg2 = variance_deg2 + turned_deg**2
    # an angle that is not known contradicts nothing
    return None if (apart_deg > _SIGMAS * np.sqrt(variance_deg2)).any() else basis


def predicted_deg(basis: BalanceBasis, at_us: int, spacecraft: Spacecraft) -> FloatArray:
    """Return the angles (3,), deg, predicted for an instant from what the basis knows."""
    ahead_s = (at_us - basis.epoch_us) / US_PER_S
    moment = np.zeros(3)
    if basis.disturbance is not None:
        moment = 0.5 * np.array(basis.disturbance.torque_n_m((basis.epoch_us + at_us) // 2)) * ahead_s**2
    for pulse in basis.executed:
        lasting_s = min(pulse.duration_s, (at_us - pulse.start_us) / US_PER_S)
        if lasting_s > 0.0:
            turning_s = min(ahead_s, (at_us - pulse.start_us) / US_PER_S - 0.5 * lasting_s)
            moment = moment + np.array(pulse.torque_n_m) * lasting_s * turning_s
    drift_deg = np.array(basis.rates_deg_s) * ahead_s
    return np.array(basis.attitude_deg) + drift_deg + np.degrees(_inverse_1_kg_m2(spacecraft) @ moment)


def balance_axes(inhibitions: tuple[str, ...], basis: BalanceBasis | None) -> tuple[bool, bool, bool]:
    """Return the axes whose known torque may be balanced: nothing but doubt about the angles of the present stands."""
    return basis.axes if basis is not None and inhibitions and BALANCED.issuperset(inhibitions) else NO_AXES


def balance_row(row: AttitudeRow, axes: tuple[bool, bool, bool]) -> AttitudeRow:
    """Return a row for a command that balances: its rates, and no angle that asks for a correction."""
    still = Axes(0.0, 0.0, 0.0)
    return replace(
        row,
        attitude_deg=still,
        steering_deg=NO_ANGLES,
        rates_deg_s=row.rates_deg_s or still,
        control_allowed=True,
        control_allowed_axes=axes,
        inhibitions=(),
    )


@lru_cache(maxsize=64)
def _inverse_1_kg_m2(spacecraft: Spacecraft) -> FloatArray:
    """Return the inverse (3, 3) of the tensor of inertia; the catalogue hardly ever changes."""
    return inverse_of(inertia_about_angles(np.array(spacecraft.inertia_kg_m2)))
