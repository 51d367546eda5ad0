"""Catalogue: what real links, operations, repeaters, weather and wrong reports add to the textbook."""

from dataclasses import replace

from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.world.scenario import events
from analyzer_sim.world.scenario.story import (
    TURNS_H,
    KeepingErrors,
    NoiseStatistics,
    PolarimeterFigures,
    RateTelemetry,
    RepeaterSettings,
    Scenario,
    StationNoise,
    WheelTelemetry,
)

#: levels of 284 real microwave links: with the default sweep's own noise these parts give their Allan deviation and
#: autocorrelation from a minute to half a day
FLICKER_NOISE = NoiseStatistics(
    white_scale=0.0,
    coloured_db=(0.0, 0.0),
    chain_db=0.0,
    chain_daily_db=0.0,
    thermal_db=0.12,
    flicker=((0.05, 240.0), (0.083, 900.0), (0.11, 3600.0), (0.105, 72_000.0)),
    chain_flicker=((0.07, 3600.0), (0.085, 72_000.0)),
    quantum_db=0.15,
)
#: days near an equinox, when the spacecraft passes the Earth's shadow and the Sun passes behind it
_EQUINOX_US = epoch_us_from_text("2026-09-18T00:00:00Z")
_STORMS = events.Storm("storms", 5)
_DAYS_BETWEEN = 30
_NOT_COUPLED = KeepingErrors(is_coupled=False, is_coupling_announced=False)

HARD: tuple[Scenario, ...] = (
    Scenario(
        "flicker", "Noise as real links have it: flicker, steps of 0.15 dB, a day of 0.24 dB.", noise=FLICKER_NOISE
    ),
    Scenario(
        "flicker_storm",
        "Flicker noise and five rain cells, each over several stations in turn; wet antennas dry over an hour.",
        noise=FLICKER_NOISE,
        faults=(_STORMS,),
    ),
    Scenario(
        "flicker_hard",
        "Flicker noise with 0.2 dB in the slowest part, a third more on some carriers, and nine rain cells.",
        noise=replace(
            FLICKER_NOISE,
            flicker=((0.06, 240.0), (0.10, 900.0), (0.13, 3600.0), (0.20, 72_000.0)),
            flicker_scale=(0.8, 1.35),
        ),
        # what the operator of the other worlds knows is more than powers of such noise tell
        keeping=KeepingErrors(is_steered_by_powers=True),
        faults=(replace(_STORMS, count=9),),
    ),
    Scenario(
        "yaw_hold",
        "Yaw is turned by +0.4, later by -0.4 deg for six hours without notice; all other corrections are announced.",
        manoeuvres=(
            events.Hold(8.0, 6.0, 40.0, yaw_deg=0.4, is_announced=False, is_balance_announced=True),
            events.Hold(27.0, 6.0, 40.0, yaw_deg=-0.4, is_announced=False, is_balance_announced=True),
        ),
    ),
    Scenario(
        "stale_calibration",
        "Thirty days between calibration and alignment: levels moved by 0.5 dB, two carriers gone, two new.",
        plan="ku16_changed",
        pause_h=24.0 * _DAYS_BETWEEN,
        faults=(
            events.Relevel("new levels", -1.0),
            events.PlanChange("new plan", -1.0, gone=("c06", "c13"), new=("c16", "c17")),
        ),
    ),
    Scenario(
        "eclipse",
        "Two nights with an eclipse: gains fall by 0.2-0.5 dB, the reflector bends by 0.02-0.05 deg.",
        start_us=_EQUINOX_US,
        # operation begins at 09:30; the shadow is crossed around 17:53, midnight at 90 deg East
        faults=(events.Eclipse("first night", (7.8, 7.9)), events.Eclipse("second night", (31.8, 31.9))),
    ),
    Scenario(
        "sun_outage",
        "On two days the Sun stands behind the satellite: noise up by 3-10 dB for at most a quarter of an hour.",
        start_us=epoch_us_from_text("2026-10-08T00:00:00Z"),
        faults=(
            events.SunOutage("first day", (19.9, 20.0)),
            events.SunOutage("second day", (43.9, 44.0)),
        ),
    ),
    Scenario(
        "alc",
        "One transponder holds its total power, so that its carriers move one another; rain and steps on them.",
        repeater=RepeaterSettings(alc_transponders=("Ku3",)),
        faults=(
            events.UplinkRain("showers", 4, ("c08", "c09", "c10", "c11"), start_h=(2.0, 44.0), depth_db=(2.0, 6.0)),
            events.Step("steps", 2, ("c11", "c09"), start_h=(6.0, 40.0)),
            events.SwitchOff("carrier off", ("c10",), start_h=(20.0, 26.0)),
        ),
    ),
    Scenario(
        "upc",
        "One station steers its power by what comes back, and the catalogue says so.",
        repeater=RepeaterSettings(power_controlled=("c04",)),
        faults=(events.UplinkRain("showers", 3, ("c04",), start_h=(3.0, 40.0)),),
    ),
    Scenario(
        "upc_untold",
        "One station steers its power by what comes back, and the catalogue does not know.",
        repeater=RepeaterSettings(power_controlled=("c04",), is_power_control_announced=False),
        faults=(events.UplinkRain("showers", 3, ("c04",), start_h=(3.0, 40.0)),),
    ),
    Scenario(
        "no_coupling",
        "The on-board mode does not follow the orbital rate, and the catalogue says so: roll and yaw do not exchange.",
        keeping=_NOT_COUPLED,
    ),
    Scenario(
        "burn",
        "Station keeping in both directions disturbs the attitude; the ephemeris is void for six hours.",
        burns=(
            events.Burn(
                "station keeping", (20.0, 20.0), drift_deg_day=(0.005, 0.012), attitude_uncertainty_deg=(0.2, 0.1, 0.1)
            ),
        ),
        manoeuvres=(events.Hold(20.1, 0.6, 10.0, yaw_deg=0.12, roll_deg=0.07, pitch_deg=-0.06, is_announced=False),),
    ),
    Scenario(
        "works",
        "Declared work: carriers off the air, a transponder's gain changed, the receiving chain switched over.",
        faults=(
            events.SwitchOff("carriers off", ("c05", "c11"), (6.0, 10.0), (2.0, 4.0), (-1.0, 1.5), is_announced=True),
            events.GroupStep("gain", start_h=(18.0, 24.0), is_announced=True),
            events.ChainStep("switch-over", (32.0, 38.0), (-3.0, -1.0), is_announced=True),
        ),
    ),
)


#: ordinary polarimeter, with a shower over the receiving site
_POLARIZED = Scenario(
    "polarized",
    "As nominal; a polarimeter reports each row: leakage, its day and wander, Faraday rotation, a shower.",
    faults=(events.DownlinkRain("site shower", (6.0, 40.0), (2.0, 4.0), (0.05, 0.3), (30.0, 90.0)),),
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


#: a station's level is that of a real link; beside it stand the receiving chain and the noise of the sweep
LINK_NOISE = NoiseStatistics(
    white_scale=0.0, coloured_db=(0.0, 0.0), thermal_db=0.0, wander_scale=0.0, station=StationNoise()
)
#: an operator who knew the truth would give it away: in weather his error is less than that of any filter of powers
_STEERED = KeepingErrors(is_steered_by_powers=True)
_FAR = events.Weather("weather")
#: hours from the start of operation at which turns and alignment begin
_ALIGNMENT_H = -1.0
_TURNS_H = _ALIGNMENT_H - TURNS_H


def _weather(name: str, summary: str, *faults: events.Fault) -> Scenario:
    return Scenario(name, summary, noise=LINK_NOISE, keeping=_STEERED, faults=faults)


WEATHER: tuple[Scenario, ...] = (
    _weather("weather_far", "Levels and weather of real links; each station has weather systems of its own.", _FAR),
    _weather(
        "weather_near",
        "As weather_far; a weather system takes 85 % of the stations within an hour or two.",
        replace(_FAR, shared=0.85),
    ),
    _weather(
        "weather_turns",
        "As weather_far; a further system stands over half of the stations during the calibration turns.",
        _FAR,
        events.WeatherSystem("storm of the turns", (_TURNS_H - 1.0, _TURNS_H), (TURNS_H, TURNS_H + 1.0), 0.5),
    ),
    _weather(
        "weather_alignment",
        "As weather_far; a shower passes over a quarter of the stations during the alignment.",
        _FAR,
        events.Showers("showers of the alignment", (_ALIGNMENT_H, _ALIGNMENT_H + 0.5), 0.25),
    ),
    _weather(
        "weather_wet_season",
        "As weather_far with half as many systems again.",
        replace(_FAR, interval_days=_FAR.interval_days / 1.5),
    ),
)


_PLAIN_DRIFT_DEG_H = KeepingErrors().drift_deg_h
_TRIPLE_DRIFT_DEG_H = (3.0 * _PLAIN_DRIFT_DEG_H[0], 3.0 * _PLAIN_DRIFT_DEG_H[1], 3.0 * _PLAIN_DRIFT_DEG_H[2])


def _false_reports(name: str, executed_share: float, command: str) -> Scenario:
    """Return two days with two slews of 0.15 deg an axis of which the spacecraft does only a share."""
    reports = tuple(events.FalseReport(f"slew {day}", 9.0 + 21.0 * day, executed_share) for day in range(2))
    summary = (
        f"Twice in two days, for two hours, announced corrections of 0.15 deg an axis are {command} by the spacecraft."
    )
    return Scenario(name, summary, manoeuvres=reports)


WRONG: tuple[Scenario, ...] = (
    Scenario(
        "nominal_tau5",
        "As nominal; the coloured noise of the carriers lasts 5 min instead of 20.",
        noise=NoiseStatistics(coloured_tau_s=300.0),
    ),
    Scenario(
        "nominal_tau120",
        "As nominal; the coloured noise of the carriers lasts 120 min instead of 20.",
        noise=NoiseStatistics(coloured_tau_s=7200.0),
    ),
    Scenario(
        "nominal_drift3",
        "As nominal; the inertial model drifts three times as fast.",
        keeping=KeepingErrors(drift_deg_h=_TRIPLE_DRIFT_DEG_H),
    ),
    Scenario(
        "nominal_uncoupled",
        "As nominal; roll and yaw do not exchange although the catalogue says that they do.",
        keeping=KeepingErrors(is_coupled=False),
    ),
    Scenario("nominal_10s", "As nominal, a row each 10 s.", row_period_s=10.0),
    Scenario("nominal_300s", "As nominal, a row each 300 s.", row_period_s=300.0),
    _false_reports("corrections_flipped", -1.0, "carried out with the other sign"),
    _false_reports("corrections_halved", 0.5, "carried out by half"),
    _false_reports("corrections_lost", 0.0, "not carried out"),
    _false_reports("corrections_doubled", 2.0, "carried out twice"),
)
