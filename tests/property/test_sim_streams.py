"""Streams and geometry of the simulation."""

from dataclasses import replace
from functools import cache

import numpy as np
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer_sim.world.orbit import antenna_angles_deg, body_from_orbital
from analyzer_sim.world.scenario.events import (
    ChainStep,
    DownlinkRain,
    Eclipse,
    Fault,
    Gap,
    Interference,
    Step,
    Storm,
    SunOutage,
    SwitchOff,
    UplinkRain,
)
from analyzer_sim.world.scenario.scenario import SCENARIOS
from analyzer_sim.world.world import World

#: events of one carrier, c03, which no scenario's level control holds
_OF_ONE: tuple[Fault, ...] = (
    UplinkRain("extra", 1, ("c03",), start_h=(0.1, 1.0)),
    SwitchOff("extra", ("c03",), (0.5, 1.0), (0.5, 1.0)),
    Step("extra", 1, ("c03",), (0.1, 1.5)),
    Interference("extra", 1, ("c03",), (0.1, 1.0)),
)
#: events of all carriers
_OF_ALL: tuple[Fault, ...] = (
    DownlinkRain("extra", (0.2, 0.5)),
    ChainStep("extra", (0.5, 1.0)),
    SunOutage("extra", (0.5, 1.0)),
    Eclipse("extra", (0.5, 1.0)),
    Storm("extra", 2, (0.2, 1.0)),
    Gap("extra", 1, (0.5, 1.0)),
)
#: rows of 10 s cost the most and draw from the same streams
_NAMES = sorted(set(SCENARIOS) - {"nominal_10s"})


def short(name):
    """Return a scenario of few hours whose operator does not see the powers, or corrections would pass a fault on."""
    keeping = replace(SCENARIOS[name].keeping, is_steered_by_powers=False)
    return replace(SCENARIOS[name], quiet_h=1.0, alignment_h=0.75, operation_h=2.5, keeping=keeping)


@cache
def plain(name, seed):
    return World(short(name), seed)


def with_extra(name, seed, fault):
    scenario = short(name)
    return World(replace(scenario, faults=(fault, *scenario.faults)), seed)


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(st.sampled_from(_NAMES), st.integers(0, 3), st.sampled_from(_OF_ONE))
def test_a_fault_of_one_carrier_leaves_everything_else_bit_identical(name, seed, fault):
    before, after = plain(name, seed).rows, with_extra(name, seed, fault).rows
    others = [k for k in range(before.power_dbm.shape[1]) if k != 3]
    assert after.carrier_dbm[:, others].tobytes() == before.carrier_dbm[:, others].tobytes()
    assert after.uplink_fade_db[:, others].tobytes() == before.uplink_fade_db[:, others].tobytes()
    assert after.chain_db.tobytes() == before.chain_db.tobytes()
    assert after.noise_dbm_hz.tobytes() == before.noise_dbm_hz.tobytes()
    assert after.flags[:, others].tobytes() == before.flags[:, others].tobytes()


@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(st.sampled_from(_NAMES), st.integers(0, 3), st.sampled_from(_OF_ONE + _OF_ALL))
def test_no_fault_moves_attitude_knowledge_or_orbit(name, seed, fault):
    before, after = plain(name, seed), with_extra(name, seed, fault)
    assert after.rows.attitude_deg.tobytes() == before.rows.attitude_deg.tobytes()
    assert after.references.attitude_deg.tobytes() == before.references.attitude_deg.tobytes()
    assert after.corrections == before.corrections
    assert after.orbit == before.orbit
    assert set(before.operations) <= set(after.operations)


@settings(max_examples=examples(30), deadline=None, derandomize=True)
@given(st.sampled_from(_NAMES), st.integers(0, 3), st.sampled_from(_OF_ALL))
def test_what_a_fault_of_all_adds_is_what_it_says_and_the_noise_stays(name, seed, fault):
    noise = SCENARIOS[name].noise
    station = None if noise.station is None else replace(noise.station, quantum_db=0.0)
    figures = replace(noise, quantum_db=0.0, station=station)
    scenario = replace(short(name), noise=figures, repeater=type(SCENARIOS[name].repeater)())
    before = World(scenario, seed).rows
    after_world = World(replace(scenario, faults=(fault, *scenario.faults)), seed)
    after = after_world.rows
    if isinstance(fault, Eclipse):
        return  # it bends the pattern as well; its own tests say how
    reported = (
        (after.level_db - before.level_db)
        - (after.uplink_fade_db - before.uplink_fade_db)
        + (after.chain_db - before.chain_db)[:, None]
        - (after.downlink_fade_db - before.downlink_fade_db)[:, None] * after_world.plan.rain_share
    )
    np.testing.assert_allclose(after.carrier_dbm - before.carrier_dbm, reported, atol=1e-9)  # rounding of -43 dBm


angle = st.floats(-30.0, 30.0, allow_nan=False)
small = st.floats(-0.5, 0.5, allow_nan=False)
position = st.floats(-8.5, 8.5, allow_nan=False)


@settings(max_examples=examples(100), derandomize=True)
@given(yaw=angle, roll=angle, pitch=angle)
def test_every_attitude_is_a_rotation(yaw, roll, pitch):
    turn = body_from_orbital(np.array([[yaw, roll, pitch]]))[0]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)  # rounding
    assert abs(np.linalg.det(turn) - 1.0) < 1e-14


@settings(max_examples=examples(100), derandomize=True)
@given(yaw=small, roll=small, pitch=small, az=position, el=position)
def test_signs_hold_everywhere_on_the_disc(yaw, roll, pitch, az, el):
    direction = np.array([np.tan(np.radians(az)), -np.tan(np.radians(el)), 1.0])
    turned = body_from_orbital(np.array([[yaw, roll, pitch]]))[0] @ direction
    az_new, el_new = antenna_angles_deg(turned)
    first_az = -pitch - yaw * np.radians(el)
    first_el = -roll + yaw * np.radians(az)
    # terms left out: angle times 0.15^2 (2.2 %) and products of two turns of 0.5 deg (0.009 deg)
    slack = 0.025 * (abs(yaw) + abs(roll) + abs(pitch)) + 0.009
    assert abs(az_new - az - first_az) < slack
    assert abs(el_new - el - first_el) < slack
