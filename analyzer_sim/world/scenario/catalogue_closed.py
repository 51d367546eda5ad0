"""Catalogue, stories for closed loops alone: they begin away from zero and mean nothing where no torque is flown."""

from analyzer_sim.world.scenario.events import DownlinkRain
from analyzer_sim.world.scenario.story import KeepingErrors, ResidualTorque, Scenario

#: size of the angles from which the loop slews to zero, deg
SLEW_DEG = 0.35
#: size of the torques that nobody knows, N m
_RESIDUAL_N_M = (2e-7, 2e-6)

CLOSED: tuple[Scenario, ...] = (
    Scenario(
        "slew_fade",
        "Roll and pitch begin 0.35 deg off; 20 min into the slew to zero all carriers fade by 2 dB for an hour.",
        keeping=KeepingErrors(alignment_deg=(0.0, SLEW_DEG, SLEW_DEG)),
        operation_h=12.0,
        faults=(DownlinkRain("downlink rain", (1.0 / 3.0, 1.0 / 3.0), (2.0, 2.0), (0.3, 0.3), (60.0, 60.0)),),
    ),
    Scenario(
        "unknown_residual_constant",
        "A constant torque of 2e-7 to 2e-6 N m about each axis is not fed forward, and the catalogue does not know.",
        keeping=KeepingErrors(residual=ResidualTorque(_RESIDUAL_N_M)),
        operation_h=24.0,
    ),
    Scenario(
        "unknown_residual_daily",
        "As unknown_residual_constant; the torque about each axis is a wave of one day.",
        keeping=KeepingErrors(residual=ResidualTorque(_RESIDUAL_N_M, is_daily=True)),
        operation_h=24.0,
    ),
)
