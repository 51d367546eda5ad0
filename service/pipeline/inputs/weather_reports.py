"""Reports of rain over uplink stations, kept for some hours, and what they say of each carrier.

A report holds for half an hour. An antenna stays wet for two hours after the rain, so that a dry report counts only
where no rain was reported meanwhile; of several sources the one that reports rain is believed.
"""

from bisect import bisect_right, insort
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.records.epoch import US_PER_S
from service.records.inputs import WeatherReport
from service.records.levels.attitude import FloatArray

#: so long reports are kept
KEPT_US = 6 * 3600 * US_PER_S
#: a report holds, and an antenna stays wet
_HOLDS_US, _WET_US = 1800 * US_PER_S, 2 * 3600 * US_PER_S
#: rain rate and attenuation from which a report says rain
_RAIN_MM_H, _RAIN_DB = 0.5, 0.15
#: reports of one station and source, one a minute for six hours and some
_MOST = 400


class StationReports(NamedTuple):
    """Reports of one source about one station, in order of epoch, microseconds UTC."""

    epochs_us: tuple[int, ...]
    #: those that say rain
    rain_us: tuple[int, ...]


#: by name of the station, then by source
WeatherReports = dict[str, dict[str, StationReports]]


def with_report(reports: WeatherReports, report: WeatherReport) -> WeatherReports:
    """Return the reports with one more; those more than six hours older than the newest of their kind are left out."""
    of_station = reports.get(report.station, {})
    before = of_station.get(report.source, StationReports((), ()))
    after = StationReports(
        _inserted(before.epochs_us, report.epoch_us),
        _inserted(before.rain_us, report.epoch_us) if _is_rain(report) else before.rain_us,
    )
    return {**reports, report.station: {**of_station, report.source: after}}


def reported_wet(reports: WeatherReports, stations: Sequence[str], epoch_us: int) -> FloatArray:
    """Return for carriers of some stations (N,) 1 where rain is reported, 0 where none is, NaN where nobody says."""
    verdicts = {name: _verdict(of_station, epoch_us) for name, of_station in reports.items()}
    return np.array([verdicts.get(name, np.nan) for name in stations])


def _verdict(of_station: dict[str, StationReports], epoch_us: int) -> float:
    """Return 1 where a source reports rain, 0 where one reports none, NaN where none reports."""
    if any(_is_within(each.rain_us, epoch_us, _WET_US) for each in of_station.values()):
        return 1.0
    return 0.0 if any(_is_within(each.epochs_us, epoch_us, _HOLDS_US) for each in of_station.values()) else np.nan


def _is_within(epochs_us: tuple[int, ...], epoch_us: int, age_us: int) -> bool:
    """Return whether the newest epoch that is not later than another is within an age of it."""
    position = bisect_right(epochs_us, epoch_us)
    return position > 0 and epoch_us - epochs_us[position - 1] <= age_us


def _inserted(epochs_us: tuple[int, ...], epoch_us: int) -> tuple[int, ...]:
    every = list(epochs_us)
    insort(every, epoch_us)
    return tuple(each for each in every[-_MOST:] if every[-1] - each <= KEPT_US)


def _is_rain(report: WeatherReport) -> bool:
    return (report.rain_rate_mm_h or 0.0) >= _RAIN_MM_H or (report.attenuation_db or 0.0) >= _RAIN_DB
