"""From powers to torques through the interface: calibrate, align, track, replay; torques and what ends them."""

import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.ports.archive import Outcome
from service.records.catalogue import ControlMode, ControlSettings, Method, Release
from service.records.epoch import format_epoch
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import Axes
from service.runtime.live.supervisor import Supervisor

pytestmark = pytest.mark.anyio


SC = "/spacecraft/yamal-202"
SEED = 11
PERIOD_S = 86_328.0
SIGMA_DB = 0.01
HOUR_US = 3_600_000_000
#: dB per deg of yaw, roll, pitch, the same to both sides
SENSITIVITY = np.array(
    [[0.05, 2.0, 0.3], [-0.05, -1.8, 0.2], [0.02, 0.4, 1.9], [-0.02, 0.3, -2.0], [0.30, 0.5, -0.6], [-0.28, -0.6, 0.5]]
)
AMPLITUDE_DB = np.array([0.35, 0.2, 0.5, 0.1, 0.3, 0.4])
PHASE_RAD = np.array([-0.6, 1.0, 2.0, -2.0, 0.3, 3.0])


class World:
    """Powers of six carriers at given angles."""

    def __init__(self, node_us: int) -> None:
        self._node_us = node_us
        self._rng = np.random.default_rng(SEED)

    def power_dbm(self, epochs_us: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
        """Return rows of powers."""
        phase_rad = 2 * np.pi * (epochs_us - self._node_us) / (PERIOD_S * 1e6)
        harmonic_db = AMPLITUDE_DB * np.cos(phase_rad[:, None] + PHASE_RAD)
        noise_db = self._rng.normal(0.0, SIGMA_DB, (len(epochs_us), 6))
        return -42.0 + harmonic_db + angles_deg @ SENSITIVITY.T + noise_db


def send(bench: Any, make: Any, world: World, epochs_us: np.ndarray, angles_deg: np.ndarray, *, star: bool) -> None:
    """Store rows, with a star tracker that tells the angles or without."""
    bench.append([int(epoch_us) for epoch_us in epochs_us], world.power_dbm(epochs_us, angles_deg))
    if star:
        sigma_deg = Axes(0.01, 0.005, 0.005)
        references = [
            AttitudeReference("star_tracker", int(epoch_us), Axes(*map(float, angles)), sigma_deg)
            for epoch_us, angles in zip(epochs_us, angles_deg, strict=True)
        ]
        bench.storage.archive.append_inputs(make.sc, references)


async def done(bench: Any, job: str) -> None:
    """Wait for a job that has to end well."""
    while True:
        answer = (await bench.client.get(f"/api/v1/jobs/{job}")).json()
        assert answer["state"] != "failed", answer
        if answer["state"] == "done":
            return
        await asyncio.sleep(0.02)


async def post(bench: Any, path: str, body: Any = None) -> Any:
    """Return what a step answers."""
    answer = await bench.client.post(bench.url + path, json=body)
    assert answer.status_code in {200, 201, 202}, answer.text
    return answer.json()


async def settled(bench: Any, make: Any) -> dict[str, Any]:
    """Return the status when everything was consumed."""
    while True:
        status = await bench.get("/status")
        head = bench.storage.archive.head(make.sc)
        if status["pending"] == 0 and head.consumed_number == head.newest_number:
            return status
        await asyncio.sleep(0.02)


async def test_from_powers_to_torques(bench, make):
    print("seed", SEED)
    bench.clock.data[make.sc] = make.now_us
    # commands of a simulated spacecraft stand at the epochs of its rows, whenever these were received
    catalogue = bench.storage.catalogue
    catalogue.replace_spacecraft(replace(catalogue.spacecraft(make.sc), simulated=True))
    world = World(make.now_us)
    # 48 hours of quiet every ten minutes, six turns of two hours every two minutes
    quiet_us = make.now_us - 60 * HOUR_US + np.arange(288) * 600 * make.s
    send(bench, make, world, quiet_us, np.zeros((288, 3)), star=False)
    turns_us = make.now_us - 12 * HOUR_US + np.arange(330) * 120 * make.s
    turns_deg = np.zeros((330, 3))
    for k in range(6):
        part = slice(k * 55, k * 55 + 55)
        turns_deg[part, k % 3] = np.sin(np.linspace(0, np.pi, 55)) * (0.5 if k < 3 else -0.5)
    send(bench, make, world, turns_us, turns_deg, star=True)
    bench.context.supervisor.start()

    quiet = {"start": format_epoch(quiet_us[0]), "stop": format_epoch(quiet_us[-1] + 1)}
    turns = {"start": format_epoch(turns_us[0]), "stop": format_epoch(turns_us[-1] + 1)}
    started = await post(bench, "/calibrations", {"quiet": quiet, "turns": turns, "method": "paper"})
    await done(bench, started["job"])
    # slopes of this world are drawn, no antennas make them
    reason = {"override_reason": "slopes without beams"}
    calibration = await post(bench, f"/calibrations/{started['id']}:activate", reason)
    assert calibration["state"] == "active"
    for k, carrier in enumerate(calibration["carriers"]):
        found = list(carrier["sensitivity_db_per_deg"].values())
        # 110 rows an axis near 0.35 deg: 0.01 / (0.35 sqrt 110) = 0.003 dB/deg, and a twentieth for the harmonic's rest
        assert found == pytest.approx(SENSITIVITY[k].tolist(), abs=0.03)
        assert carrier["harmonic"]["amplitude_db"] == pytest.approx(AMPLITUDE_DB[k], abs=0.005)

    window_us = make.now_us + np.arange(20) * 60 * make.s
    send(bench, make, world, window_us, np.zeros((20, 3)), star=True)
    aligned = await post(
        bench,
        "/alignments",
        {"start": format_epoch(window_us[0]), "stop": format_epoch(window_us[-1] + 1), "source": "star_tracker"},
    )
    assert aligned["roll_deg"] == pytest.approx(0.0, abs=1e-9)
    assert aligned["epoch"] == format_epoch(window_us[-1])
    assert len(aligned["references"]) == 6
    assert (aligned["rows_recomputed"], aligned["rows_kept"]) == (0, 0)

    live_us = window_us[-1] + (1 + np.arange(40)) * 60 * make.s
    send(bench, make, world, live_us, np.tile([0.0, 0.05, -0.05], (40, 1)), star=False)
    bench.context.supervisor.notify(make.sc)
    status = await settled(bench, make)
    assert (status["aligned"], status["newest_attitude"]) == (True, format_epoch(live_us[-1]))
    newest = await bench.get("/attitude")
    # fifteen rows of 0.01 dB on six carriers of 2 dB/deg: 0.002 deg; the references add as much
    assert newest["roll_deg"] == pytest.approx(0.05, abs=0.02)
    assert newest["pitch_deg"] == pytest.approx(-0.05, abs=0.02)
    assert newest["status"] == "ACQUIRED"
    assert newest["alignment_id"] == aligned["id"]
    torques = await bench.get("/torques")
    assert torques["attitude_epoch"] == newest["epoch"]
    assert torques["control_allowed"] == newest["control_allowed"]
    carriers = await bench.get("/measurements")
    assert {row["state"] for row in carriers} <= {"used", "unselected", "excluded"}
    used = [row for row in carriers if row["state"] == "used"]
    assert len(used) >= 4
    assert all(abs(row["deviation_db"]) < 1.0 and row["epoch"] == newest["epoch"] for row in used)

    await replay_equals_live(bench, live_us)
    reported = await bench.get("/carrier-selection", count=5)
    assert len(reported["selected"]) == 5
    # each step stands in the audit log once, with the number of what it made
    assert [(entry.audit_event.action, entry.audit_event.target) for entry in bench.storage.audit.chain()] == [
        ("start_calibration", f"{SC}/calibrations/{started['id']}"),
        ("activate_calibration", f"{SC}/calibrations/{started['id']}:activate"),
        ("align", f"{SC}/alignments/{aligned['id']}"),
        ("start_replay", f"{SC}/replays/1"),
    ]


async def replay_equals_live(bench: Any, live_us: np.ndarray) -> None:
    """A replay in the journal's order gives the live rows to the last bit."""
    span = {"start": format_epoch(live_us[0]), "stop": format_epoch(live_us[-1] + 1)}
    started = await post(bench, "/replays", span)
    await done(bench, started["job"])
    for path in ("/attitude/history", "/torques/history"):
        live = (await bench.get(path, **span))["rows"]
        again = (await bench.get(path, **span, version=started["version"]))["rows"]
        assert len(live) == len(live_us)
        assert [{**row, "version": "live"} for row in again] == [{**row, "version": "live"} for row in live]
    files = [
        (await bench.client.get(f"{bench.url}/archive/attitude:export", params={**span, "version": version})).content
        for version in ("live", started["version"])
    ]
    assert files[0] == files[1]


async def test_before_the_first_command_torques_are_null(bench, make):
    newest = await bench.get("/torques")
    assert [newest[name] for name in ("roll_n_m", "pitch_n_m", "yaw_n_m", "epoch", "predicted")] == [None] * 5
    assert (newest["inhibitions"], newest["control_allowed"]) == (["no_attitude"], False)
    bench.append([make.now_us])
    bench.consume()
    again = await bench.get("/torques")
    assert (again.pop("control")["allowed"], newest.pop("control")["allowed"]) == (False, False)
    assert again == newest | {"attitude_epoch": format_epoch(make.now_us)}, "the epoch advances with every row"


async def test_command_is_told_field_by_field(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    epoch = "2026-11-21T03:00:00.000000Z"
    newest = await bench.get("/torques")
    assert newest.pop("control") == (await bench.get("/control"))["control"]
    assert newest == {
        "epoch": epoch,
        "attitude_epoch": epoch,
        "mode": "ground",
        "roll_n_m": -0.002,
        "pitch_n_m": 0.003,
        "yaw_n_m": 0.0,
        "wheels_n_m": [0.002, -0.003, 0.0],
        "saturated": False,
        "command_period_s": 60.0,
        "valid_until": "2026-11-21T03:01:00.000000Z",
        "schedule": [{"start": epoch, "duration_s": 2.5, "roll_n_m": -0.05, "pitch_n_m": 0.0, "yaw_n_m": 0.0}],
        "impulse_n_m_s": {"yaw": 0.0, "roll": -0.12, "pitch": 0.18},
        "predicted": {
            "angle_change_deg": {"yaw": 0.0, "roll": -0.1, "pitch": 0.2},
            "rate_change_deg_s": {"yaw": 0.0, "roll": -1e-5, "pitch": 2e-5},
            "wheel_momentum_n_m_s": [0.12, -0.18, 0.0],
        },
        "control_allowed": True,
        "balance_allowed_axes": {"yaw": False, "roll": False, "pitch": False},
        "inhibitions": [],
        "schedule_check": None,
    }


async def test_row_without_a_command_ends_the_one_before(bench, make):
    first, second = bench.append([make.now_us, make.now_us + 60 * make.s])
    lost = make.row(second, inhibitions=("late",), control_allowed=False)
    bench.consume([Outcome((make.row(first),), make.command(first)), Outcome((lost,), None)])
    newest = await bench.get("/torques")
    assert (newest["roll_n_m"], newest["pitch_n_m"], newest["yaw_n_m"]) == (0.0, 0.0, 0.0)
    assert (newest["control_allowed"], newest["inhibitions"], newest["schedule"]) == (False, ["late"], [])
    assert newest["attitude_epoch"] == format_epoch(second.epoch_us)
    assert newest["wheels_n_m"] == [0.0, 0.0, 0.0]
    assert len((await bench.get("/torques/history"))["rows"]) == 1, "the answer is not stored"


async def test_command_of_an_expired_row_is_zero(bench, make):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    bench.clock.system = make.now_us + 211 * make.s
    newest = await bench.get("/torques")
    assert (newest["roll_n_m"], newest["control_allowed"], newest["inhibitions"]) == (0.0, False, ["expired"])
    assert (newest["control"]["allowed"], newest["control"]["state"]) == (False, "INHIBITED")
    assert ("expired", None) in [(each["code"], each["since"]) for each in newest["control"]["reasons"]]
    assert (await bench.get("/status"))["control"] == newest["control"]


async def test_no_torque_goes_while_a_chain_is_brought_back(bench, make, monkeypatch):
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    monkeypatch.setattr(Supervisor, "is_catching_up", lambda *_: True)
    torque, attitude = await bench.get("/torques"), await bench.get("/attitude")
    assert (torque["roll_n_m"], torque["control_allowed"], torque["inhibitions"]) == (0.0, False, ["catch_up"])
    assert (attitude["epoch"], attitude["status"]) == (format_epoch(row.epoch_us), "ACQUIRED"), "the row is still told"
    assert (attitude["control_allowed"], attitude["inhibitions"]) == (False, ["catch_up"])
    for answer in (torque, attitude, await bench.get("/status"), await bench.get("/control")):
        assert answer["control"]["allowed"] is False
        assert "catch_up" in [each["code"] for each in answer["control"]["reasons"]]
    assert (await bench.get("/torques/history"))["rows"][0]["control_allowed"], "what is stored stays"


#: of the release: no row was seen, the ephemeris ends soon
NOT_READY = ["ephemeris", "not_aligned", "estimate_old"]
INTERLOCKS = {
    "automatic": (Release.AUTOMATIC, {"state": "INHIBITED", "reasons": NOT_READY}),
    "two steps": (Release.TWO_STEP, {"state": "INHIBITED", "reasons": [*NOT_READY, "not_armed", "yaw_sign"]}),
}


@pytest.mark.parametrize(("release", "interlock"), INTERLOCKS.values(), ids=INTERLOCKS)
async def test_status_tells_the_interlock(bench, make, release, interlock):
    stored = bench.storage.catalogue.spacecraft(make.sc)
    control = ControlSettings(Method.PAPER, ControlMode.GROUND, release)
    bench.storage.catalogue.replace_spacecraft(replace(stored, control=control))
    (row,) = bench.append([make.now_us])
    bench.consume([Outcome((make.row(row),), make.command(row))])
    status = await bench.get("/status")
    assert status["interlock"] == interlock
    control = await bench.get("/control")
    assert status["control"] == control["control"] == (await bench.get("/attitude", method="robust"))["control"]
    assert {name: control[name] for name in ("state", "reasons")} == interlock


async def test_status_of_an_empty_and_of_a_filled_archive(bench, make):
    empty = await bench.get("/status")
    assert empty.pop("control")["allowed"] is False
    assert empty.pop("interlock")["reasons"] == [*NOT_READY[:-1], "estimate_old", "no_attitude"]
    assert empty == {
        "newest_measurement": None,
        "newest_attitude": None,
        "pending": 0,
        "aligned": False,
        "realignment_advised": False,
        "methods_disagree": False,
        "advice": [],
        "clock": "system",
        "now": format_epoch(make.now_us),
        "links": [],
        "method": "paper",
        "calibration_id": None,
        "alignment_id": None,
    }
    bench.calibrate([make.carrier_calibration(0, (0.1, 1.0, 0.2))])
    bench.align(make.now_us - 60 * make.s)
    consumed, pending = bench.append([make.now_us, make.now_us + 60 * make.s])
    bench.storage.results.save_outcomes(
        make.sc, "live", [Outcome((make.row(consumed),), None)], consumed.number, consumed.epoch_us
    )
    bench.clock.data[make.sc] = pending.epoch_us
    filled = await bench.get("/status")
    assert filled["pending"] == 1
    assert filled["newest_measurement"] == format_epoch(pending.epoch_us)
    assert filled["newest_attitude"] == format_epoch(consumed.epoch_us)
    assert (filled["clock"], filled["now"]) == ("data", format_epoch(pending.epoch_us))
    assert (filled["aligned"], filled["calibration_id"], filled["alignment_id"]) == (True, 1, 1)
    nobody = dict.fromkeys(("id", "kind", "state", "enabled", "age_s", "last_good_age_s"))
    newest = {"source": "sa-1", "role": "prime", "newest_epoch": format_epoch(pending.epoch_us), "rows": 2}
    assert filled["links"] == [{**newest, "rows_missing": None, **nobody, "warnings": []}]
