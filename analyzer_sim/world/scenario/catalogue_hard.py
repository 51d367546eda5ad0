"""Catalogue, second part: what real links, real operations and real repeaters add to the textbook."""

from dataclasses import replace

from analyzer_sim.epochs import epoch_us_from_text
from analyzer_sim.world.scenario.events import (
    Burn,
    ChainStep,
    Eclipse,
    GroupStep,
    Hold,
    PlanChange,
    Relevel,
    Step,
    Storm,
    SunOutage,
    SwitchOff,
    UplinkRain,
)
from analyzer_sim.world.scenario.story import KeepingErrors, NoiseStatistics, RepeaterSettings, Scenario

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
_STORMS = Storm("storms", 5)
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
            Hold(8.0, 6.0, 40.0, yaw_deg=0.4, is_announced=False, is_balance_announced=True),
            Hold(27.0, 6.0, 40.0, yaw_deg=-0.4, is_announced=False, is_balance_announced=True),
        ),
    ),
    Scenario(
        "stale_calibration",
        "Thirty days between calibration and alignment: levels moved by 0.5 dB, two carriers gone, two new.",
        plan="ku16_changed",
        pause_h=24.0 * _DAYS_BETWEEN,
        faults=(
            Relevel("new levels", -1.0),
            PlanChange("new plan", -1.0, gone=("c06", "c13"), new=("c16", "c17")),
        ),
    ),
    Scenario(
        "eclipse",
        "Two nights with an eclipse: gains fall by 0.2-0.5 dB, the reflector bends by 0.02-0.05 deg.",
        start_us=_EQUINOX_US,
        # operation begins at 09:30; the shadow is crossed around 17:53, midnight at 90 deg East
        faults=(Eclipse("first night", (7.8, 7.9)), Eclipse("second night", (31.8, 31.9))),
    ),
    Scenario(
        "sun_outage",
        "On two days the Sun stands behind the satellite: noise up by 3-10 dB for at most a quarter of an hour.",
        start_us=epoch_us_from_text("2026-10-08T00:00:00Z"),
        faults=(
            SunOutage("first day", (19.9, 20.0)),
            SunOutage("second day", (43.9, 44.0)),
        ),
    ),
    Scenario(
        "alc",
        "One transponder holds its total power, so that its carriers move one another; rain and steps on them.",
        repeater=RepeaterSettings(alc_transponders=("Ku3",)),
        faults=(
            UplinkRain("showers", 4, ("c08", "c09", "c10", "c11"), start_h=(2.0, 44.0), depth_db=(2.0, 6.0)),
            Step("steps", 2, ("c11", "c09"), start_h=(6.0, 40.0)),
            SwitchOff("carrier off", ("c10",), start_h=(20.0, 26.0)),
        ),
    ),
    Scenario(
        "upc",
        "One station steers its power by what comes back, and the catalogue says so.",
        repeater=RepeaterSettings(power_controlled=("c04",)),
        faults=(UplinkRain("showers", 3, ("c04",), start_h=(3.0, 40.0)),),
    ),
    Scenario(
        "upc_untold",
        "One station steers its power by what comes back, and the catalogue does not know.",
        repeater=RepeaterSettings(power_controlled=("c04",), is_power_control_announced=False),
        faults=(UplinkRain("showers", 3, ("c04",), start_h=(3.0, 40.0)),),
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
            Burn(
                "station keeping", (20.0, 20.0), drift_deg_day=(0.005, 0.012), attitude_uncertainty_deg=(0.2, 0.1, 0.1)
            ),
        ),
        manoeuvres=(Hold(20.1, 0.6, 10.0, yaw_deg=0.12, roll_deg=0.07, pitch_deg=-0.06, is_announced=False),),
    ),
    Scenario(
        "works",
        "Declared work: carriers off the air, a transponder's gain changed, the receiving chain switched over.",
        faults=(
            SwitchOff("carriers off", ("c05", "c11"), (6.0, 10.0), (2.0, 4.0), (-1.0, 1.5), is_announced=True),
            GroupStep("gain", start_h=(18.0, 24.0), is_announced=True),
            ChainStep("switch-over", (32.0, 38.0), (-3.0, -1.0), is_announced=True),
        ),
    ),
)
