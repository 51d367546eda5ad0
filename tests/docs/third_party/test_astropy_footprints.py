"""The page on astropy: its blocks against a service, and the same places computed without astropy."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skyfield.api import load
from skyfield.framelib import itrs

from db.storage import SqlStorage
from service.ports.archive import LIVE, ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import Carrier, Method, Site, Spacecraft
from service.records.levels.attitude import Axes, Status, row_without_attitude
from service.records.levels.measurement import MeasurementBatch

PAGE = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "compute-footprints-with-astropy.md"
#: 2026-11-21T01:00:00Z
START_US = 1_795_222_800_000_000
STEP_US = 3_600_000_000
LONGITUDE_DEG = 90.0
RADIUS_M = 42_164_172.0
#: yaw, roll, pitch; the last row has none
ANGLES_DEG = [
    (0.0, 0.0, 0.0),
    (0.0, 0.1, 0.0),
    (0.0, 0.0, 0.1),
    (0.5, 0.0, 0.0),
    (-30.0, 0.4, -0.3),
    (2.0, -1.5, 3.0),
    (0.0, 9.0, 0.0),
]
TLE = (
    "1 90001U 26001A   26325.00000000  .00000000  00000+0  00000+0 0  9999",
    "2 90001   3.0000  80.0000 0002000  10.0000 150.0000  1.00270000    08",
)


@pytest.fixture
def archive(tmp_path: Path) -> None:
    """Store rows with known angles where the service will look for its archive."""
    storage = SqlStorage(f"sqlite:///{tmp_path / 'archive.db'}")
    storage.prepare()
    inertia = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
    craft = Spacecraft("yamal-202", "Yamal-202", LONGITUDE_DEG, Site(56.7, 37.2), inertia, 0.05)
    storage.catalogue.add_spacecraft(craft)
    plan = storage.catalogue.put_plan("yamal-202", [Carrier("c00", "Ku", "Ku1", 11.2e9, 1e6)], "plan")
    count = len(ANGLES_DEG) + 1
    epochs_us = START_US + STEP_US * np.arange(count)
    powers = np.full((count, 1), -42.0, dtype=np.float32)
    batch = MeasurementBatch(
        "yamal-202",
        "sa-1",
        plan.id,
        int(epochs_us[-1]),
        np.arange(count),
        epochs_us,
        powers,
        (None,) * count,
        np.zeros(count, dtype=bool),
    )
    assert storage.archive.append_measurements(batch).result(120).accepted == count
    window = Window(START_US, int(epochs_us[-1]) + 1)
    rows = storage.archive.measurements("yamal-202", ListPart(window, 100))
    outcomes = []
    for row, angles in zip(rows, [*ANGLES_DEG, None], strict=True):
        found = row_without_attitude(row.epoch_us, row.received_at_us, row.number, Method.ROBUST, ("not_aligned",))
        if angles is not None:
            found = replace(found, attitude_deg=Axes(*angles), status=Status.ACQUIRED, inhibitions=())
        outcomes.append(Outcome((found,), None))
    storage.results.save_outcomes("yamal-202", LIVE, outcomes, rows[-1].number, rows[-1].epoch_us)
    storage.close()


@pytest.fixture
def page(archive: None, service: Any) -> dict[str, Any]:
    """Return the names that the blocks of the page leave."""
    names: dict[str, Any] = {"URL": service.url, "KEY": service.environment["SOO_KEY"]}
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 5
    for block in blocks:
        exec(compile(block, PAGE.name, "exec"), names)  # noqa: S102 - our own page
    return names


def turn(axis: int, angle_deg: float) -> np.ndarray:
    """Return the matrix that turns a frame about one of its axes: components of a fixed vector before to after."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix[one, one] = matrix[other, other] = cosine
    matrix[one, other], matrix[other, one] = sine, -sine
    return matrix


def direction_of(angles_deg: tuple[float, float, float], body: np.ndarray) -> np.ndarray:
    """Return a direction of the body in axes fixed to the Earth: x through the spacecraft, y East, z North."""
    yaw, roll, pitch = angles_deg
    nadir = (turn(0, roll) @ turn(1, pitch) @ turn(2, yaw)).T @ body
    east, south, down = nadir
    return np.array([-down, east, -south])


def place_of(direction: np.ndarray) -> tuple[float, float]:
    """Return longitude and geodetic latitude of where a ray from the spacecraft meets WGS 84, by bisection."""
    flattened = np.array([1.0, 1.0, 6_378_137.0 / 6_356_752.314245])

    def height(share: float) -> float:
        return float(np.linalg.norm((np.array([RADIUS_M, 0, 0]) + share * direction) * flattened) - 6_378_137.0)

    near, far = 30_000_000.0, RADIUS_M * -direction[0]
    if height(far) > 0:
        return np.nan, np.nan
    for _ in range(80):
        middle = (near + far) / 2
        near, far = (middle, far) if height(middle) > 0 else (near, middle)
    x, y, z = np.array([RADIUS_M, 0, 0]) + near * direction
    latitude = np.arctan2(z * flattened[2] ** 2, np.hypot(x, y))
    return LONGITUDE_DEG + float(np.degrees(np.arctan2(y, x))), float(np.degrees(latitude))


@pytest.mark.slow
@pytest.mark.system
def test_footprints_of_the_page(page: dict[str, Any]) -> None:
    assert len(page["attitude"].epochs) == len(ANGLES_DEG)
    footprints = page["footprints"]
    # the sub-satellite point, asked to a hundredth of a degree
    assert np.abs(footprints[0] - [LONGITUDE_DEG, 0.0]).max() < 1e-4
    assert footprints[1] == pytest.approx([LONGITUDE_DEG, 0.563], abs=0.01)
    assert footprints[2] == pytest.approx([LONGITUDE_DEG + 0.560, 0.0], abs=0.01)
    assert footprints[3] == pytest.approx([LONGITUDE_DEG, 0.0], abs=1e-4)
    wanted = [place_of(direction_of(angles, np.array([0.0, 0.0, 1.0]))) for angles in ANGLES_DEG]
    assert np.isnan(wanted[-1]).all(), "a roll of 9 deg misses the Earth"
    np.testing.assert_allclose(footprints, wanted, atol=1e-4, rtol=0, equal_nan=True)

    # beams off the boresight, by vectors of the test's own
    tangent = np.tan(np.radians(3.0))
    for azimuth_deg, elevation_deg, vector in ((0.0, 3.0, [0.0, -tangent, 1.0]), (3.0, 0.0, [tangent, 0.0, 1.0])):
        beam = np.array(vector) / np.linalg.norm(vector)
        assert page["beam"](azimuth_deg, elevation_deg) == pytest.approx(beam, abs=1e-12)
        found = page["footprint_deg"](page["position_m"], page["gcrs_from_body"].apply(beam))
        wanted = [place_of(direction_of(angles, beam)) for angles in ANGLES_DEG]
        np.testing.assert_allclose(found, wanted, atol=1e-4, rtol=0, equal_nan=True)
        moved = found[3] - found[0]
        assert (moved[0] > 0.1) if elevation_deg else (moved[1] < -0.1)

    # the direction in GCRS, turned to the Earth by skyfield
    times = load.timescale(builtin=True).from_astropy(page["epochs"])
    to_earth = itrs.rotation_at(times)
    earth = np.einsum("ijt,tj->ti", to_earth, page["direction"])
    of_craft = turn(2, -LONGITUDE_DEG)
    wanted = [of_craft @ direction_of(angles, np.array([0.0, 0.0, 1.0])) for angles in ANGLES_DEG]
    print("GCRS by astropy and skyfield:", np.degrees(np.abs(earth - wanted).max()), "deg")
    np.testing.assert_allclose(earth, wanted, atol=np.radians(0.001), rtol=0)

    # on an inclined orbit zero attitude looks at the Earth's centre, and North stays North
    position_m, velocity_m_s = page["on_orbit"](*TLE)
    nadir = page["gcrs_from_nadir"](position_m, velocity_m_s)
    below = page["footprint_deg"](position_m, nadir.apply([0.0, 0.0, 1.0]))
    fixed = np.einsum("ijt,tj->ti", to_earth, position_m)
    x, y, z = fixed.T
    latitude = np.degrees(np.arctan(np.tan(np.arctan2(z, np.hypot(x, y))) * (6_378_137.0 / 6_356_752.314245) ** 2))
    assert np.ptp(latitude) > 1.0
    np.testing.assert_allclose(below, np.stack([np.degrees(np.arctan2(y, x)), latitude], axis=-1), atol=0.01, rtol=0)
    north = page["footprint_deg"](position_m, nadir.apply(page["beam"](0.0, 1.0)))
    assert (north[:, 1] - below[:, 1] > 5.0).all()
