"""Beams by points of gain: slopes and curvature where the points tell them, nothing where they do not."""

import numpy as np
import pytest

from service.core.geometry.frames import station_direction
from service.pipeline.planning.beam_contours import ContourBeam, ContourPoint, contour_beams
from service.records.catalogue import Carrier, Station

LONGITUDE_DEG = 90.0
STATIONS = ((56.0, 60.0), (52.0, 85.0), (60.0, 70.0))


def carriers(transponder: str = "Ku1") -> tuple[Carrier, ...]:
    return tuple(
        Carrier(f"c{k}", "Ku", transponder, 11.2e9, 1e6, Station(latitude, longitude))
        for k, (latitude, longitude) in enumerate(STATIONS)
    )


def gain_db(latitude_deg: float, longitude_deg: float) -> float:
    seen = station_direction([longitude_deg], [latitude_deg], [0.0], LONGITUDE_DEG)
    u, v = float(seen.azimuth_deg[0]) + 2.0, float(seen.elevation_deg[0]) - 8.0
    return -0.8 * u**2 + 0.3 * u * v - 1.3 * v**2


def grid(step_deg: float = 2.0, low: float = 40.0) -> list[ContourPoint]:
    sites = [(n, e) for n in np.arange(low, 72.1, step_deg) for e in np.arange(46.0, 100.1, step_deg)]
    return [
        ContourPoint(line, "Ku1", float(n), float(e), gain_db(float(n), float(e)))
        for line, (n, e) in enumerate(sites, start=2)
    ]


def test_a_quadratic_comes_back() -> None:
    beam = contour_beams(grid(), carriers(), LONGITUDE_DEG)["Ku1"]
    shape = beam.shape_at(np.array([-3.0]), np.array([8.3]))
    u, v = -3.0 + 2.0, 8.3 - 8.0
    assert shape.gain_db[0] == pytest.approx(-0.8 * u**2 + 0.3 * u * v - 1.3 * v**2)
    assert shape.gradient_db_per_deg[0] == pytest.approx([-1.6 * u + 0.3 * v, 0.3 * u - 2.6 * v])
    assert shape.hessian_db_per_deg2[0] == pytest.approx([-1.6, 0.3, -2.6])


def test_points_far_away_tell_nothing() -> None:
    beam = contour_beams(grid(), carriers(), LONGITUDE_DEG)["Ku1"]
    assert np.isnan(beam.shape_at(np.array([4.0]), np.array([-3.0])).gain_db).all()


def test_a_single_contour_does_not_tell_the_slope_across_it() -> None:
    along = np.linspace(-2.0, 2.0, 200)
    line = ContourBeam(along, 8.0 + 0.02 * along, np.full(200, -3.0))
    assert np.isnan(line.shape_at(np.array([0.0]), np.array([8.0])).gradient_db_per_deg).all()


def test_three_contours_tell_it() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 120)
    rings = [(r * np.cos(angle), 8.0 + r * np.sin(angle), np.full(120, -1.3 * r**2)) for r in (1.0, 1.4, 1.8)]
    beam = ContourBeam(*(np.concatenate(part) for part in zip(*rings, strict=True)))
    shape = beam.shape_at(np.array([1.4]), np.array([8.0]))
    assert shape.gradient_db_per_deg[0] == pytest.approx([-2.6 * 1.4, 0.0], abs=0.05)


def test_points_that_are_not_seen_are_refused() -> None:
    west = [one._replace(longitude_deg=one.longitude_deg - 150.0) for one in grid()]
    with pytest.raises(ValueError, match=r"points: line 2: the satellite at 90 deg East stands at -"):
        contour_beams(west, carriers(), LONGITUDE_DEG)


def test_exchanged_coordinates_are_named() -> None:
    station = (Carrier("c0", "Ku", "Ku1", 11.2e9, 1e6, Station(42.0, 74.0)),)
    sites = [(n, e) for n in np.arange(34.0, 50.1, 2.0) for e in np.arange(66.0, 80.1, 2.0)]
    straight = [ContourPoint(2, "Ku1", n, e, gain_db(n, e)) for n, e in sites]
    assert "Ku1" in contour_beams(straight, station, LONGITUDE_DEG)
    swapped = [one._replace(latitude_deg=one.longitude_deg, longitude_deg=one.latitude_deg) for one in straight]
    with pytest.raises(ValueError, match=r"of Ku1 \(first: line 2\) .*; latitude and longitude look exchanged"):
        contour_beams(swapped, station, LONGITUDE_DEG)


def test_points_of_another_region_are_refused() -> None:
    south = [one._replace(latitude_deg=-one.latitude_deg) for one in grid()]
    with pytest.raises(ValueError, match="do not reach a station of the plan; check transponder, satellite"):
        contour_beams(south, carriers(), LONGITUDE_DEG)


def test_points_below_the_horizon_do_not_count() -> None:
    known = contour_beams(grid(), carriers(), LONGITUDE_DEG)["Ku1"]
    beyond = [ContourPoint(9000 + k, "Ku1", 50.0, -60.0 - k, -20.0) for k in range(20)]
    assert len(contour_beams(grid() + beyond, carriers(), LONGITUDE_DEG)["Ku1"].gain_db) == len(known.gain_db)
