"""The robust method's step where an operation was declared: work, gains, turns, eclipse and outage."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, PAYLOAD, Stepped

from service.records.inputs import Operation
from service.records.levels.attitude import Status


def declared(stepped, kind, start, stop, **changes):
    operation = Operation(1, kind, ALIGNED_US + start * MINUTE, ALIGNED_US + stop * MINUTE, **changes)
    stepped.knowledge = replace(stepped.knowledge, operations={1: operation})


def test_carriers_that_are_worked_on_are_masked_and_come_back_at_another_level():
    stepped = Stepped(angles=(0.0, 0.1, -0.1))
    declared(stepped, "carrier_work", 30, 40, carriers=("c01", "c02"))
    for minute in range(1, 30):
        stepped.step(minute)
    during = np.where(np.isin(np.arange(16), [1, 2]), -15.0, 0.0)
    rows = [stepped.step(minute, during).row for minute in range(30, 40)]
    for row in rows:
        assert [(item.carrier, item.reason) for item in row.excluded] == [("c01", "manual"), ("c02", "manual")]
        np.testing.assert_allclose(row.attitude_deg, [0.0, 0.1, -0.1], atol=0.01)
        assert row.control_allowed
    after = np.where(np.isin(np.arange(16), [1, 2]), 1.5, 0.0)
    back = [stepped.step(minute, after).row for minute in range(40, 60)]
    assert {row.carriers_used for row in back} == {16}
    np.testing.assert_allclose([row.attitude_deg for row in back], np.tile([0.0, 0.1, -0.1], (20, 1)), atol=0.01)


def test_a_declared_change_of_gain_moves_no_angle_and_flags_no_carrier():
    stepped = Stepped(angles=(0.0, 0.1, -0.1))
    declared(stepped, "gain_change", 30, 50, transponders=("Ku1",))
    own = np.array([name == "Ku1" for name in PAYLOAD.transponders])
    for minute in range(1, 80):
        row = stepped.step(minute, np.where(own & (30 <= minute < 50), 1.4, 0.0)).row
        np.testing.assert_allclose(row.attitude_deg, [0.0, 0.1, -0.1], atol=0.01)
        assert row.carriers_used == 16


def test_work_on_the_receiving_chain_holds_control_at_both_ends():
    stepped = Stepped()
    declared(stepped, "receive_chain_work", 30, 60)
    rows = [stepped.step(minute, -1.0 if 30 <= minute < 60 else 0.0).row for minute in range(1, 90)]
    assert rows[28].control_allowed
    assert "chain_step" in rows[29].inhibitions
    assert "chain_step" in rows[59].inhibitions
    assert rows[75].control_allowed
    assert not any(row.downlink_fade for row in rows)
    np.testing.assert_allclose([row.attitude_deg for row in rows], 0.0, atol=0.01)


@pytest.mark.parametrize("kind", ["station_keeping", "momentum_unloading", "calibration_turn"])
def test_an_operation_that_turns_the_craft_widens_sigma_and_is_followed(kind):
    quiet, turned = Stepped(), Stepped()
    declared(turned, kind, 30, 40, inhibit_control=True)
    moved = np.array([0.0, 0.06, -0.05])
    for minute in range(1, 120):
        plain = quiet.step(minute).row
        share = np.clip((minute - 30) / 10, 0.0, 1.0)
        row = turned.step(minute, angles=share * moved).row
        assert ("operation" in row.inhibitions) == (30 <= minute < 40)
        if minute == 40:
            assert (np.array(row.sigma_deg) > 1.2 * np.array(plain.sigma_deg)).all()
    np.testing.assert_allclose(row.attitude_deg[1:], moved[1:], atol=0.01)


def test_an_eclipse_lets_gains_walk_and_the_attitude_stays():
    stepped = Stepped()
    declared(stepped, "eclipse", 30, 100)
    label = np.array([int(name == "Ku2") for name in PAYLOAD.transponders])
    for minute in range(1, 200):
        cooled = (
            -0.4 * (1.0 - np.exp(-max(0, minute - 30) / 20)) if minute < 100 else -0.4 * np.exp(-(minute - 100) / 20)
        )
        row = stepped.step(minute, cooled * label).row
        assert row.carriers_used == 16
        np.testing.assert_allclose(row.attitude_deg[1:], 0.0, atol=0.02)


def test_a_sun_outage_masks_everything():
    stepped = Stepped()
    stepped.step(1)
    declared(stepped, "sun_outage", 2, 5)
    row = stepped.step(2, 5.0).row
    assert {item.reason for item in row.excluded} == {"manual"}
    assert row.status is Status.EXPIRED
    assert stepped.step(5).row.status is Status.ACQUIRED
