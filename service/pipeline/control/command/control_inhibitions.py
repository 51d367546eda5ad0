"""Reasons for which a row leads to no torque: of the row, of the spacecraft's settings, and of the law."""

from service.pipeline.control.command.mean_torque import is_gyro_orbitant, rate_inhibition
from service.records.catalogue import ControlMode, Spacecraft
from service.records.levels.attitude import AttitudeRow, Axes

#: reasons beside those of the interlock for which a command stays zero, with what each one says
CONTROL_INHIBITIONS: dict[str, str] = {
    "mode_onboard": "torques are computed on board",
    "mode_off": "attitude control is switched off",
    "no_fast_loop": "the catalogue states no fast loop or no Forecast mode on board",
    "no_rate": "too few fixes yet for an angular rate",
    "no_law": "inertia, wheels, period and damping of the catalogue give no control law; see the service log",
    "no_body_rate": "the law gyro_orbitant needs body rates about all axes in telemetry that is not too old",
    "law_beyond": "the roll rate exceeds the orbital rate, or the spacecraft turns against its orbit: no yaw follows",
    "tripped": "control has tripped; torques are withheld until ten good minutes after the reset",
}


def control_inhibitions(
    row: AttitudeRow, spacecraft: Spacecraft, *, is_withheld: bool = False, body_rate_deg_s: Axes | None = None
) -> tuple[str, ...]:
    """Return why this row may not lead to a torque: the row's reasons and those of the spacecraft's settings."""
    reasons = list(row.inhibitions)
    if spacecraft.control.mode is not ControlMode.GROUND:
        reasons.append(f"mode_{spacecraft.control.mode.value}")
    elif not (spacecraft.onboard.fast_loop and spacecraft.onboard.forecast_mode):
        reasons.append("no_fast_loop")
    lacking = _rate_inhibition(row, spacecraft, body_rate_deg_s)
    if not row.inhibitions and lacking is not None:
        reasons.append(lacking)
    if is_withheld:
        reasons.append("tripped")
    return tuple(reasons)


def _rate_inhibition(row: AttitudeRow, spacecraft: Spacecraft, body_rate_deg_s: Axes | None) -> str | None:
    """Return why the law of the spacecraft has no rates that it can use."""
    if is_gyro_orbitant(spacecraft):
        return rate_inhibition(body_rate_deg_s)
    return "no_rate" if row.rates_deg_s is None else None
