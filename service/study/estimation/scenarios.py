"""Scenarios of a campaign by group; ``docs/evidence/scenarios.md`` says what happens in each."""

#: not a scenario of the simulator but the trials of the fix of one epoch alone
SNAPSHOT = "snapshot"

_PLAIN = ("nominal", "white", "few8", "many32", "octants", "init_bias", "maneuver", "long14", "demo")
_FAULTS = ("steps", "steps_heavy", "uplink_rain", "transponder", "interference", "gaps", "mixed", "mixed32")
_RAIN = (
    "downlink_rain",
    "downlink_rain_0p02",
    "downlink_rain_0p05",
    "downlink_rain_0p3",
    "downlink_rain_1",
    "downlink_rain_3",
    "downlink_slow",
    "downlink_slew",
    "dual_band",
    "drift",
)
_HARD = (
    "flicker",
    "flicker_storm",
    "flicker_hard",
    "yaw_hold",
    "stale_calibration",
    "eclipse",
    "sun_outage",
    "alc",
    "upc",
    "upc_untold",
    "no_coupling",
    "burn",
    "works",
)
_MISMATCH = (
    "nominal_tau5",
    "nominal_tau120",
    "nominal_drift3",
    "nominal_uncoupled",
    "nominal_10s",
    "nominal_300s",
    "corrections_flipped",
    "corrections_halved",
    "corrections_lost",
    "corrections_doubled",
)
_SOURCES = ("beacons", "sensors", "prime_backup", "replan", "blackout", "few3", "corrections_late", "antenna_wave")
_WEATHER = ("weather_far", "weather_near", "weather_turns", "weather_alignment", "weather_wet_season")
_MOTION = (
    *("wheels", "wheels_hourly", "wheels_unstated", "wheels_unmarked", "wheels_misaligned", "wheels_zero"),
    *("rates", "rates_biased"),
)
_POLARIZATION = ("polarized", "polarized_storm", "feed_turned", "leak_drift")
#: the worlds by which "never confident and wrong" is judged
_YARDSTICK = (
    *_WEATHER,
    "flicker_hard",
    *("nominal", "mixed", "steps_heavy", "octants", "downlink_rain", "yaw_hold"),
)

GROUPS: dict[str, tuple[str, ...]] = {
    "quick": ("nominal", "octants", "downlink_rain"),
    "plain": _PLAIN,
    "faults": _FAULTS,
    "rain": _RAIN,
    "hard": _HARD,
    "mismatch": _MISMATCH,
    "sources": _SOURCES,
    "weather": _WEATHER,
    "motion": _MOTION,
    "polarization": _POLARIZATION,
    "yardstick": _YARDSTICK,
    "snapshot": (SNAPSHOT,),
    "all": (*_PLAIN, *_FAULTS, *_RAIN, *_HARD, *_MISMATCH, *_SOURCES, *_WEATHER, *_MOTION, *_POLARIZATION, SNAPSHOT),
}
