"""Claims about which stations are reported wet, dry, or not at all."""

import numpy as np
import pytest

from service.pipeline.inputs.weather_reports import reported_wet, with_report
from service.records.inputs import WeatherReport

MINUTE_US, HOUR_US = 60_000_000, 3_600_000_000


def reports(*rows):
    """Return the reports of rows (source, station, hour, attenuation)."""
    kept = {}
    for source, station, hour, attenuation_db in rows:
        kept = with_report(kept, WeatherReport(source, station, round(hour * HOUR_US), None, attenuation_db))
    return kept


def verdicts(kept, hour, *stations):
    return reported_wet(kept, stations, round(hour * HOUR_US)).tolist()


def test_a_station_is_wet_dry_or_nobody_says():
    kept = reports(("radar", "Kyiv", 1.0, 2.0), ("radar", "Minsk", 1.0, 0.0))
    np.testing.assert_array_equal(verdicts(kept, 1.1, "Minsk", "Kyiv", "Omsk", ""), [0.0, 1.0, np.nan, np.nan])


@pytest.mark.parametrize(("rate_mm_h", "is_rain"), [(0.0, 0.0), (0.4, 0.0), (0.5, 1.0), (40.0, 1.0)])
def test_a_rain_rate_serves_as_an_attenuation_does(rate_mm_h, is_rain):
    kept = with_report({}, WeatherReport("gauge", "Kyiv", 0, rate_mm_h))
    assert verdicts(kept, 0.0, "Kyiv") == [is_rain]


def test_a_report_holds_for_half_an_hour_and_rain_for_two_hours():
    dry, rain = reports(("radar", "Kyiv", 0.0, 0.0)), reports(("radar", "Kyiv", 0.0, 1.0))
    np.testing.assert_array_equal([verdicts(dry, h, "Kyiv")[0] for h in (0.5, 0.51)], [0.0, np.nan])
    np.testing.assert_array_equal([verdicts(rain, h, "Kyiv")[0] for h in (2.0, 2.01)], [1.0, np.nan])


def test_an_antenna_dries_after_the_rain():
    kept = reports(*(("radar", "Kyiv", h / 4, 1.0 if h < 4 else 0.0) for h in range(16)))
    assert [verdicts(kept, h, "Kyiv")[0] for h in (0.9, 2.0, 2.7, 3.0)] == [1.0, 1.0, 1.0, 0.0]


def test_what_is_reported_of_later_says_nothing_of_now():
    kept = reports(("radar", "Kyiv", 0.0, 0.0), ("radar", "Kyiv", 3.0, 5.0))
    assert verdicts(kept, 0.2, "Kyiv") == [0.0]
    assert np.isnan(verdicts(kept, -0.1, "Kyiv")).all()


def test_reports_may_come_in_any_order_and_the_source_that_sees_rain_is_believed():
    rows = [("radar", "Kyiv", 1.0, 1.0), ("radar", "Kyiv", 0.5, 0.0), ("gauge", "Kyiv", 1.0, 0.0)]
    assert verdicts(reports(*rows), 1.0, "Kyiv") == verdicts(reports(*rows[::-1]), 1.0, "Kyiv") == [1.0]
    assert verdicts(reports(*rows), 0.6, "Kyiv") == [0.0]


def test_hours_and_a_number_of_reports_are_kept():
    often = reports(*(("radar", "Kyiv", k / 3600, 0.0) for k in range(1000)))
    assert len(often["Kyiv"]["radar"].epochs_us) == 400
    long = reports(*(("radar", "Kyiv", k / 2, 1.0) for k in range(30)))
    assert len(long["Kyiv"]["radar"].epochs_us) == len(long["Kyiv"]["radar"].rain_us) == 13
