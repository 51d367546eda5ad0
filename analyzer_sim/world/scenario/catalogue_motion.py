"""Catalogue, measured motion: telemetry of the wheels and of a rate sensor that follows from the attitude."""

from analyzer_sim.world.scenario.story import RateTelemetry, Scenario, WheelTelemetry

MOTION: tuple[Scenario, ...] = (
    Scenario(
        "wheels",
        "As nominal; wheels with 8 N m s along pitch are told to 0.01 N m s each 5 min, unloaded each 12 h.",
        wheels=WheelTelemetry(),
    ),
    Scenario("wheels_hourly", "As wheels, told each hour.", wheels=WheelTelemetry(period_min=60.0)),
    Scenario(
        "wheels_unmarked",
        "As wheels; telemetry does not say when thrusters unload them.",
        wheels=WheelTelemetry(is_unloading_marked=False),
    ),
    Scenario(
        "wheels_misaligned",
        "As wheels, their axes wrong by three times as much.",
        wheels=WheelTelemetry(misalignment_deg=0.15),
    ),
    Scenario("wheels_zero", "As wheels, without momentum along pitch.", wheels=WheelTelemetry(bias_n_m_s=0.0)),
    Scenario(
        "rates",
        "As nominal; a rate sensor beside the loop, of 0.01 deg/h of bias, tells the rate of the body each minute.",
        rates=RateTelemetry(),
    ),
    Scenario("rates_biased", "As rates, the bias five times as large as stated.", rates=RateTelemetry(bias_factor=5.0)),
)
