"""Catalogue, fifth part: weather over the users' stations with the statistics of 284 real links."""

from dataclasses import replace

from analyzer_sim.world.scenario.events import Fault, Showers, Weather, WeatherSystem
from analyzer_sim.world.scenario.story import KeepingErrors, NoiseStatistics, Scenario, StationNoise
from analyzer_sim.world.scenario.turns import TURNS_H

#: a station's level is that of a real link; beside it stand the receiving chain and the noise of the sweep
LINK_NOISE = NoiseStatistics(
    white_scale=0.0, coloured_db=(0.0, 0.0), thermal_db=0.0, wander_scale=0.0, station=StationNoise()
)
#: an operator who knew the truth would give it away: in weather his error is less than that of any filter of powers
_STEERED = KeepingErrors(is_steered_by_powers=True)
_FAR = Weather("weather")
#: hours from the start of operation at which turns and alignment begin
_ALIGNMENT_H = -1.0
_TURNS_H = _ALIGNMENT_H - TURNS_H


def _weather(name: str, summary: str, *faults: Fault) -> Scenario:
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
        WeatherSystem("storm of the turns", (_TURNS_H - 1.0, _TURNS_H), (TURNS_H, TURNS_H + 1.0), 0.5),
    ),
    _weather(
        "weather_alignment",
        "As weather_far; a shower passes over a quarter of the stations during the alignment.",
        _FAR,
        Showers("showers of the alignment", (_ALIGNMENT_H, _ALIGNMENT_H + 0.5), 0.25),
    ),
    _weather(
        "weather_wet_season",
        "As weather_far with half as many systems again.",
        replace(_FAR, interval_days=_FAR.interval_days / 1.5),
    ),
)
