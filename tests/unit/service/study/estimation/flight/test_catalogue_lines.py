"""Lines of the simulator's ground become the records that the interface would have made of them."""

from service.records.catalogue import ControlMode, Method, Release, WheelMomentum
from service.records.epoch import parse_epoch
from service.records.levels.attitude import Axes
from service.study.estimation.flight.catalogue_lines import (
    read_carriers,
    read_ephemeris,
    read_operation,
    read_spacecraft,
    read_telemetry,
)

START = "2026-11-21T00:00:00.000000Z"
STOP = "2026-11-21T01:00:00.000000Z"
SPACECRAFT = {
    "id": "yamal-202",
    "name": "Yamal-202 (simulated)",
    "cospar_id": "2003-053B",
    "longitude_deg": 90,
    "simulated": True,
    "receiving_site": {"name": "site", "latitude_deg": 55.0, "longitude_deg": 37.0, "height_m": 180.0},
    "inertia_kg_m2": [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]],
    "torque_limit_n_m": 0.05,
    "onboard": {"fast_loop": True, "forecast_mode": True, "roll_yaw_coupling": False},
    "control": {"method": "paper", "mode": "ground", "release": "automatic"},
}
CARRIER = {
    "id": "c00",
    "name": "station 512k",
    "station": {"name": "station", "latitude_deg": 60.0, "longitude_deg": 90.0},
    "band": "Ku",
    "transponder": "Ku1",
    "polarization": "H",
    "uplink_hz": 14.1e9,
    "downlink_hz": 11.1e9,
    "intermediate_hz": 1.2e9,
    "bandwidth_hz": 6e5,
    "kind": "traffic",
    "uplink_power_control": "none",
    "transponder_mode": "alc",
    "enabled": True,
}


def test_a_spacecraft_keeps_what_the_ground_says_of_its_coupling_and_control():
    record = read_spacecraft(SPACECRAFT)
    assert record.onboard.roll_yaw_coupling is False
    assert record.inertia_kg_m2[1] == (0.0, 1400.0, 0.0)
    assert (record.control.method, record.control.mode, record.control.release) == (
        Method.PAPER,
        ControlMode.GROUND,
        Release.AUTOMATIC,
    )
    assert record.receiving_site.height_m == 180.0


def test_a_flown_spacecraft_states_its_wheels_without_a_torque_of_their_own():
    stated = {"sigma_n_m_s": 0.02, "scale_error": 0.005, "misalignment_deg": 0.05, "used": True}
    record = read_spacecraft({**SPACECRAFT, "onboard": {**SPACECRAFT["onboard"], "momentum": stated}})
    assert record.onboard.momentum == WheelMomentum(sigma_n_m_s=0.02)


def test_carriers_keep_their_order_and_a_beacon_has_no_station():
    beacon = {**CARRIER, "id": "b1", "station": None, "uplink_hz": None, "kind": "beacon"}
    first, second = read_carriers({"carriers": [CARRIER, beacon]})
    assert first.station is not None
    assert (first.id, first.station.latitude_deg, first.transponder_mode) == ("c00", 60.0, "alc")
    assert second.station is None
    assert not second.is_usable_for_attitude


def test_an_ephemeris_is_valid_as_far_as_its_track():
    track = {"epochs": [START, STOP], "latitude_deg": [0.0, 0.01], "longitude_deg": [90.0, 90.01]}
    reported = read_ephemeris({"ascending_nodes": [START], "nodal_period_s": 86_164.0, "track": track})
    assert (reported.valid_start_us, reported.valid_stop_us) == (parse_epoch(START), parse_epoch(STOP))
    assert reported.track is not None
    assert reported.track.latitude_deg == (0.0, 0.01)


def test_an_operation_keeps_its_uncertainty_by_axis():
    body = {
        "kind": "station_keeping",
        "start": START,
        "stop": STOP,
        "carriers": None,
        "transponders": ["Ku1"],
        "inhibit_control": True,
        "comment": "",
        "attitude_uncertainty_deg": {"yaw": 0.2, "roll": 0.1, "pitch": 0.05},
    }
    reported = read_operation(body, 7)
    assert (reported.id, reported.transponders, reported.carriers) == (7, ("Ku1",), None)
    assert reported.attitude_uncertainty_deg == Axes(0.2, 0.1, 0.05)
    del body["attitude_uncertainty_deg"]
    assert read_operation(body, 8).attitude_uncertainty_deg is None


def test_telemetry_keeps_wheels_and_thrusters():
    record = {
        "epoch": START,
        "onboard_mode": "forecast",
        "wheel_momentum_n_m_s": [1.0, -8.0, 0.5],
        "thrusters_active": False,
    }
    (reported,) = read_telemetry({"records": [record]})
    assert reported.epoch_us == parse_epoch(START)
    assert reported.wheel_momentum_n_m_s == (1.0, -8.0, 0.5)
    assert reported.thrusters_active is False
