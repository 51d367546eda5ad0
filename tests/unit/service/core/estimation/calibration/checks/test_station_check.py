"""Places of stations: right ones are left alone, a wrong one is found with the size and the side of its error."""

import numpy as np
import pytest
from geometry_payload import GeometryPayload, replace

from service.core.estimation.calibration.geometry_calibration import fit_geometry
from service.pipeline.calibration.geometry_rows import geometry_rows
from service.pipeline.config import CalibrationConfig


def offsets(payload, east_deg=0.0, north_deg=0.0):
    """Return what is found where the first station is entered so far from its place in the antenna frame."""
    rows = geometry_rows(payload.data(), CalibrationConfig())
    geometry = rows.positions.geometry
    shift = np.zeros(len(payload.carriers))
    shift[0] = 1.0
    moved = geometry._replace(
        azimuth_deg=geometry.azimuth_deg + east_deg * shift, elevation_deg=geometry.elevation_deg + north_deg * shift
    )
    return fit_geometry(rows.rows, moved).offsets


@pytest.mark.parametrize("seed", [5, 6])
def test_stations_in_their_places(seed):
    found = offsets(GeometryPayload.make(8, seed=seed))
    assert (found.chi_square < 14.0).all()  # two degrees of freedom: one in a thousand


@pytest.mark.parametrize(("east_deg", "north_deg"), [(4.0, 0.0), (-4.0, 0.0), (0.0, 4.0), (0.0, -3.0)])
def test_a_wrong_place_is_found(east_deg, north_deg):
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    # yaw moves a station across the line to it: a slope along azimuth tells its elevation, and the other way round
    beam[0, :2] = (0.3, 2.2) if east_deg else (2.2, 0.3)
    found = offsets(replace(payload, beam=beam), east_deg, north_deg)
    assert int(np.argmax(found.chi_square)) == 0
    assert found.chi_square[0] > 16.0  # the limit of the warning
    seen = found.offset_deg[0] @ [bool(east_deg), bool(north_deg)]
    assert seen == pytest.approx(-(east_deg + north_deg), abs=1.5)  # linear in the error, and held by the prior


def test_a_flat_carrier_tells_nothing():
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    beam[0] = 0.0
    found = offsets(replace(payload, beam=beam), 4.0)
    assert np.sqrt(np.diag(found.covariance_deg2[0])).min() > 5.0
    assert found.chi_square[0] < 6.0
