"""Structure of the plan: the bound of one row and the fitness of the carriers."""

from functools import cache

import numpy as np

from analyzer_sim.world.payload.payload import sensitivity_db_per_deg
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.structure import crlb_deg, report, structure_of
from analyzer_sim.world.world import World

SEED = 1


@cache
def world() -> World:
    return World(scenario_named("nominal", operation_days=0.1), SEED)


def test_bound_of_one_row_lies_in_its_ranges() -> None:
    yaw, roll, pitch = crlb_deg(sensitivity_db_per_deg(world().plan, world().orbit))
    print(f"CRLB of one row: yaw {yaw:.3f} roll {roll:.4f} pitch {pitch:.3f} deg")
    assert 0.9 <= yaw <= 1.15
    assert 0.035 <= roll <= 0.055
    assert 0.11 <= pitch <= 0.18


def test_bound_of_a_known_design() -> None:
    sensitivity = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    # two carriers of opposite slope an axis: sigma / sqrt(2), the common unknown costs nothing
    np.testing.assert_allclose(crlb_deg(sensitivity, 0.2), 0.2 / np.sqrt(2.0), rtol=1e-12)


def test_carriers_are_fit_as_planned() -> None:
    found = structure_of(world())
    print(report(world()))
    assert sum(item.is_stable and item.is_linear for item in found) >= 12
    assert [item.id for item in found if not item.is_stable] == ["c08"]  # the user with the unstable level
    assert [item.id for item in found if not item.is_linear] == ["c12"]  # the one on the top of its beam


def test_axes_are_spread() -> None:
    found = structure_of(world())
    sensitivity = np.abs([item.sensitivity_db_per_deg for item in found])
    dominant_roll = [item for item in found if item.main_axis == "roll" and item.axis_ratio >= 2.0]
    assert len(dominant_roll) >= 4
    assert int(np.sum(sensitivity[:, 2] >= 2.0 * sensitivity[:, 1])) >= 5  # pitch over roll
    assert sum(item.main_axis == "yaw" for item in found) >= 3


def test_scaled_yaw_is_bound_by_the_geometry() -> None:
    # 8 |yaw| <= 8 (|el| |pitch| + |az| |roll|) with el <= 8.5 deg and az <= 5.2 deg, 3 % for the tangents
    for item in structure_of(world()):
        yaw, roll, pitch = np.abs(item.sensitivity_db_per_deg)
        assert 8.0 * yaw <= 1.03 * 8.0 * (np.radians(8.5) * pitch + np.radians(5.2) * roll) + 0.02


def test_report_has_a_line_a_carrier() -> None:
    assert len(report(world()).splitlines()) == 1 + 16 + 2
