"""Torques: the newest command, what ends it, history; status tells the interlock."""

from dataclasses import replace

import pytest

from service.ports import Outcome
from service.records.catalogue import ControlMode, ControlSettings, Method, Release
from service.records.epoch import format_epoch
from service.runtime.live.supervisor import Supervisor

pytestmark = pytest.mark.anyio


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


async def test_history_pages(bench, make):
    rows = bench.append([make.now_us + k * 60 * make.s for k in range(3)])
    bench.consume([Outcome((make.row(row),), make.command(row)) for row in rows])
    first = await bench.get("/torques/history", limit=2)
    rest = await bench.get("/torques/history", limit=2, cursor=first["next"])
    epochs = [row["epoch"] for row in first["rows"] + rest["rows"]]
    assert epochs == [format_epoch(row.epoch_us) for row in rows]
    assert rest["next"] is None


#: of the release: no row was seen, the ephemeris ends soon
NOT_READY = ["ephemeris", "not_aligned", "estimate_old", "yaw_sign"]
INTERLOCKS = {
    "automatic": (Release.AUTOMATIC, {"state": "INHIBITED", "reasons": NOT_READY}),
    "two steps": (Release.TWO_STEP, {"state": "INHIBITED", "reasons": [*NOT_READY, "not_armed"]}),
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
    assert empty.pop("interlock")["reasons"] == [*NOT_READY[:-1], "no_attitude", "yaw_sign"]
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
