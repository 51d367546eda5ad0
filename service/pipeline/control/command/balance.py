"""Balance: what was learned before an inhibition is commanded against while no angle may be corrected.

The newest row that control could use is carried on by its own rates, by the torque known then and by what was executed
since. A command that balances takes this predicted rate and this torque away; rows of the inhibition enter nothing but
the test that ends it: where the angle that is seen leaves the predicted one by four sigma, more is wrong than the
reason that inhibits. Tried: rates and torque as the filter goes on to estimate them. Roll and pitch were better by up
to 0.05 deg through rain of two hours, but a wheel whose sign was wrong drove the spacecraft 0.3 deg away within the
hour, because a wrong command answered itself. Order everywhere: yaw, roll, pitch.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.core.control.quaternion_law import inertia_about_angles
from service.pipeline.estimation.row_inhibitions import BALANCED
from service.records.catalogue import Spacecraft
from service.records.epoch import US_PER_S
from service.records.levels.attitude import (
    NO_ANGLES,
    AttitudeRow,
    Axes,
    BalanceBasis,
    Disturbance,
    FloatArray,
    Pulse,
    named_axes,
)

#: sigmas between the angle that is seen and the predicted one
_SIGMAS = 4.0
NO_AXES = (False, False, False)


def basis_of(row: AttitudeRow, disturbance: Disturbance | None) -> BalanceBasis | None:
    """Return what a row that control could use lets be balanced after it; None where no rate is known."""
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
    """Return a basis after pulses that its row did not know."""
    return replace(basis, executed=(*basis.executed, *pulses))


def basis_at(basis: BalanceBasis, row: AttitudeRow, spacecraft: Spacecraft, hold_s: float) -> BalanceBasis | None:
    """Return a basis as it holds at a row that control may not use; None: it is too old, or the row contradicts it."""
    if row.epoch_us - basis.epoch_us > hold_s * US_PER_S:
        return None
    predicted_deg, _ = predicted_motion(basis, row.epoch_us, spacecraft)
    ahead_s = (row.epoch_us - basis.epoch_us) / US_PER_S
    apart_deg = np.abs(np.array(row.steered_deg) - predicted_deg)
    variance_deg2 = np.square(basis.sigma_deg) + np.square(row.steered_sigma_deg)
    if basis.disturbance is not None:
        turned_deg = np.degrees(_turned(np.array(basis.disturbance.sigma_n_m), spacecraft)) * 0.5 * ahead_s**2
        variance_deg2 = variance_deg2 + turned_deg**2
    # an angle that is not known contradicts nothing
    return None if (apart_deg > _SIGMAS * np.sqrt(variance_deg2)).any() else basis


def predicted_motion(basis: BalanceBasis, at_us: int, spacecraft: Spacecraft) -> tuple[FloatArray, FloatArray]:
    """Return angles (3,), deg, and rates (3,), deg/s, predicted for an instant from what the basis knows."""
    ahead_s = (at_us - basis.epoch_us) / US_PER_S
    impulse, moment = np.zeros(3), np.zeros(3)
    if basis.disturbance is not None:
        torque = np.array(basis.disturbance.torque_n_m((basis.epoch_us + at_us) // 2))
        impulse, moment = torque * ahead_s, 0.5 * torque * ahead_s**2
    for pulse in basis.executed:
        lasting_s = min(pulse.duration_s, (at_us - pulse.start_us) / US_PER_S)
        if lasting_s > 0.0:
            given = np.array(pulse.torque_n_m) * lasting_s
            impulse = impulse + given
            moment = moment + given * min(ahead_s, (at_us - pulse.start_us) / US_PER_S - 0.5 * lasting_s)
    rates_deg_s = np.array(basis.rates_deg_s)
    angles_deg = np.array(basis.attitude_deg) + rates_deg_s * ahead_s + np.degrees(_turned(moment, spacecraft))
    return angles_deg, rates_deg_s + np.degrees(_turned(impulse, spacecraft))


def balance_axes(inhibitions: tuple[str, ...], basis: BalanceBasis | None) -> tuple[bool, bool, bool]:
    """Return the axes whose known torque may be balanced: nothing but doubt about the angles of the present stands."""
    return basis.axes if basis is not None and inhibitions and BALANCED.issuperset(inhibitions) else NO_AXES


def balance_row(row: AttitudeRow, basis: BalanceBasis, spacecraft: Spacecraft) -> AttitudeRow:
    """Return a row for a command that balances: the predicted rates, and no angle that asks for a correction."""
    _, rates_deg_s = predicted_motion(basis, row.epoch_us, spacecraft)
    return replace(
        row,
        attitude_deg=Axes(0.0, 0.0, 0.0),
        steering_deg=NO_ANGLES,
        rates_deg_s=named_axes(rates_deg_s),
        control_allowed=True,
        control_allowed_axes=basis.axes,
        inhibitions=(),
    )


def _turned(impulse: FloatArray, spacecraft: Spacecraft) -> FloatArray:
    inertia = inertia_about_angles(np.array(spacecraft.inertia_kg_m2))
    return np.asarray(np.linalg.solve(inertia, impulse), dtype=np.float64)
