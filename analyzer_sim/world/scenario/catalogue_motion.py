"""Catalogue, measured motion: telemetry of the wheels and of a rate sensor, and polarimeters."""

from dataclasses import replace

from analyzer_sim.world.scenario.events import DownlinkRain
from analyzer_sim.world.scenario.story import PolarimeterFigures, RateTelemetry, Scenario, WheelTelemetry

#: ordinary polarimeter, with a shower over the receiving site
_POLARIZED = Scenario(
    "polarized",
    "As nominal; a polarimeter reports each row: leakage, its day and wander, Faraday rotation, a shower.",
    faults=(DownlinkRain("site shower", (6.0, 40.0), (2.0, 4.0), (0.05, 0.3), (30.0, 90.0)),),
    polarimeter=PolarimeterFigures(),
)

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
    Scenario(
        "wheels_unstated",
        "As wheels; the Sun's torque alone gathers in them, and the catalogue states no profile of it.",
        wheels=WheelTelemetry(torque_n_m=None, is_profile_stated=False),
    ),
    Scenario("wheels_zero", "As wheels, without momentum along pitch.", wheels=WheelTelemetry(bias_n_m_s=0.0)),
    Scenario(
        "rates",
        "As nominal; a rate sensor beside the loop, of 0.01 deg/h of bias, tells the rate of the body each minute.",
        rates=RateTelemetry(),
    ),
    Scenario("rates_biased", "As rates, the bias five times as large as stated.", rates=RateTelemetry(bias_factor=5.0)),
    _POLARIZED,
    replace(
        _POLARIZED,
        name="polarized_storm",
        summary="As polarized; from hour 12 the electron content is three times the reported one.",
        polarimeter=PolarimeterFigures(storm_factor=3.0, storm_from_h=12.0),
    ),
    replace(
        _POLARIZED,
        name="feed_turned",
        summary="As polarized; the feed turns by 0.5 deg at hour 20.",
        polarimeter=PolarimeterFigures(feed_turn_deg=0.5, feed_turn_from_h=20.0),
    ),
    replace(
        _POLARIZED,
        name="leak_drift",
        summary="As polarized; the leakage drifts by 0.002 deg/h, 5 % of it a day.",
        polarimeter=PolarimeterFigures(leak_drift_deg_h=0.002),
    ),
)
