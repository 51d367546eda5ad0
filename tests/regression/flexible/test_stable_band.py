"""T4: band of frequencies without capture, surface (26), and that (26) is (19) with the cycle's rate put in."""

import math

import pytest

from service.core.flexible.capture.capture import SwitchOn, critical_amplitude_rad, rigid_frequency_rad_s, stable_band
from service.core.flexible.closed_forms import cycle_period_s
from service.core.flexible.spacecraft import HubMode
from service.study.limit_cycles import reference
from service.study.limit_cycles.capture_tables import cycle_switch, is_captured
from service.study.limit_cycles.reference import CaptureCase

CELLS = [(coupling, swing, band) for coupling, bands in reference.BANDS.items() for swing, band in bands.items()]


@pytest.mark.parametrize(("coupling", "swing", "band"), CELLS)
def test_a_cell_of_the_table(coupling: float, swing: float, band: tuple[float, float] | None) -> None:
    found = stable_band(cycle_switch(), coupling, swing)
    if band is None:
        assert math.isnan(found.low_rad_s)
        assert math.isnan(found.high_rad_s)
    else:
        assert found == pytest.approx(band, rel=1e-6)


@pytest.mark.parametrize(("swing", "omega", "printed"), reference.SURFACE)
def test_the_surface(swing: float, omega: float, printed: float) -> None:
    found = rigid_frequency_rad_s(cycle_switch(), HubMode(omega, 0.01, 0.5), swing)
    assert found == pytest.approx(printed, rel=1e-6)


def test_the_own_frequency_of_the_cycle() -> None:
    own = 2.0 * math.pi / cycle_period_s(reference.BASE, 1.0, 1)
    assert own == pytest.approx(reference.RIGID_FREQUENCY_RAD_S, rel=1e-6)


@pytest.mark.parametrize("omega", [0.7, 4.0, 11.0])
@pytest.mark.parametrize("rate", [2e-5, 1e-4, 4e-4])
def test_the_surface_is_the_boundary_with_the_rate_of_the_cycle(omega: float, rate: float) -> None:
    mode = HubMode(omega, 0.01, 0.6)
    switch = SwitchOn(1.9895e-4, 1.05e-6, rate, 0.0175, 0.0175)
    swing = 2.0 * critical_amplitude_rad(switch, mode) / switch.alpha_rad
    period_s = 2.0 * rate * (1.0 / switch.pulse_rad_s2 + 1.0 / switch.passive_rad_s2)
    assert rigid_frequency_rad_s(switch, mode, swing) == pytest.approx(2.0 * math.pi / period_s, rel=1e-12)


@pytest.mark.parametrize("omega", [3.5, 4.2, 12.0, 70.0])
def test_the_band_is_where_the_event_simulator_stays_free(omega: float) -> None:
    coupling, swing = 0.5, 3e-4
    band, rate = stable_band(cycle_switch(), coupling, swing), cycle_switch().rate_rad_s
    case = CaptureCase(omega, coupling, 0.0, rate, 0.0175, 0.0175, math.inf, math.nan, math.nan)
    is_inside = band.low_rad_s < omega < band.high_rad_s
    assert is_captured(case, 0.5 * swing * reference.ALPHA_RAD) is not is_inside
