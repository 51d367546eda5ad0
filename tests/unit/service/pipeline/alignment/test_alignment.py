"""One alignment for every method: each gets references made with its own calibration."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload

from service.pipeline.alignment.alignment import align_methods, columns_of
from service.pipeline.config import AlignmentConfig
from service.pipeline.inputs.reference_angles import StatedAngles
from service.records.calibration import CalibrationMethod, Window
from service.records.levels.attitude import Axes

ALIGNED_US = START_US + HOUR
WINDOW = Window(ALIGNED_US - 30 * MINUTE, ALIGNED_US + 1)
STATED = StatedAngles(ALIGNED_US, Axes(0.0, 0.0, 0.0), Axes(0.01, 0.005, 0.005))
PAYLOAD = FlightPayload.make(8)


def by_paper(calibration_id=2):
    """Return a calibration of the paper method: the same carriers without a fit by geometry."""
    calibration = PAYLOAD.calibration(calibration_id)
    request = replace(calibration.request, method=CalibrationMethod.PAPER)
    return replace(calibration, request=request, result=replace(calibration.result, geometry=None))


def align(series, *calibrations):
    active = {calibration.request.method: calibration for calibration in calibrations}
    return align_methods(series, STATED, active, PAYLOAD.ephemeris(), AlignmentConfig())


@pytest.mark.parametrize(
    ("calibrations", "by_method"),
    [
        pytest.param((PAYLOAD.calibration(1),), {"robust": 1, "paper": 1}, id="geometry serves both"),
        pytest.param((PAYLOAD.calibration(1), by_paper(2)), {"robust": 1, "paper": 2}, id="each its own"),
        pytest.param((by_paper(2),), {"paper": 2}, id="paper alone"),
    ],
)
def test_each_method_has_references_of_its_calibration(calibrations, by_method):
    powers = align(PAYLOAD.series(WINDOW), *calibrations)
    assert powers.calibration_by_method == by_method
    assert set(powers.references_by_method) == set(by_method)
    first = next(iter(by_method))
    assert powers.calibration.id == by_method[first]
    assert powers.references is powers.references_by_method[first]
    if "robust" in by_method:
        found = [one.reference_dbm for one in powers.references_by_method["robust"]]
        np.testing.assert_allclose(found, PAYLOAD.level_dbm, atol=1e-4)  # exact powers, cubic between knots
    # the paper's mean has one harmonic removed where the day has more: 0.1 dB
    found = [one.reference_dbm for one in powers.references_by_method["paper"]]
    offsets = [PAYLOAD.permuted([k]).harmonic().offset_dbm for k in range(8)]
    np.testing.assert_allclose(found, offsets, atol=0.2)


def test_columns_are_brought_into_the_order_of_a_calibration():
    series = PAYLOAD.series(WINDOW)
    turned = replace(series, carrier_ids=("new", *series.carrier_ids[:0:-1]), power_dbm=series.power_dbm[:, ::-1])
    turned = replace(turned, power_dbm=np.hstack([np.full((31, 1), -99.0), series.power_dbm[:, :0:-1]]))
    columns = columns_of(turned, PAYLOAD.calibration())
    assert columns.carrier_ids == PAYLOAD.ids
    assert np.isnan(columns.power_dbm[:, 0]).all()
    np.testing.assert_array_equal(columns.power_dbm[:, 1:], series.power_dbm[:, 1:])
    powers = align(turned, PAYLOAD.calibration())
    for references in powers.references_by_method.values():
        assert [one.carrier for one in references] == list(PAYLOAD.ids[1:])


def test_a_calibration_without_result_has_no_columns():
    assert columns_of(PAYLOAD.series(WINDOW), replace(PAYLOAD.calibration(), result=None)).power_dbm.shape == (31, 0)
