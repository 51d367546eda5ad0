"""Demonstration: what is forwarded, and when the front end is replaced; all other processes are played by fakes."""

import json
from pathlib import Path

import pytest

from service.api.schemas.spacecraft import SpacecraftDocument
from service.records.epoch import format_epoch
from service.study.demonstration import demonstration
from service.study.demonstration.demonstration import ProcessAddresses, Story, run_story

MINUTE_US = 60_000_000
START_US = 1_793_491_200_000_000


def epoch(minute: int) -> str:
    return format_epoch(START_US + minute * MINUTE_US)


class Stage:
    """Everything that happens, in order."""

    def __init__(self) -> None:
        self.log: list[tuple] = []
        self.newest: str | None = None
        self.reported: str | None = None


class Link:
    """A ground port that says a script; rows are there as soon as they may be swept."""

    def __init__(self, stage: Stage, script: list[dict]) -> None:
        self._stage, self._script = stage, script

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def messages(self):
        for message in self._script:
            if message["kind"] == "truth":
                measured = [row["epoch"] for row in message["rows"] if not row.get("is_gap")]
                self._stage.reported = measured[-1] if measured else self._stage.reported
            yield message

    def proceed(self):
        self._stage.log.append(("proceed",))
        self._stage.newest = self._stage.reported


class Station:
    """A front end that only notes what it is asked."""

    def __init__(self, stage: Stage) -> None:
        self._stage, self.is_running = stage, False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def start(self, task, source):
        self.is_running = True
        self._stage.log.append(("start", task["id"], source))

    def stop(self):
        self.is_running = False
        self._stage.log.append(("stop", self._stage.newest))

    def require_alive(self):
        return None


class Client:
    """A service that agrees with everything."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def status(self, _spacecraft_id):
        return {"newest_measurement": self._stage.newest, "newest_attitude": self._stage.newest, "pending": 0}

    def request(self, method, path, body=None):
        self._stage.log.append((method, path, body))

    def start_calibration(self, _spacecraft_id, body):
        self._stage.log.append(("calibrate", body))
        return {"job": "j", "id": 1}

    def align(self, _spacecraft_id, body):
        self._stage.log.append(("align", body))
        return {}

    def __getattr__(self, name):
        return lambda *arguments: self._stage.log.append((name, *arguments))


def rows(first: int, last: int, **fields) -> dict:
    angles = {"yaw_deg": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0}
    return {"kind": "truth", "rows": [{"epoch": epoch(k), **angles, **fields} for k in range(first, last + 1)]}


def hold(last: int, phase: str) -> dict:
    return {"kind": "hold", "until": epoch(last), "phase": phase}


def plan(number: int) -> list[dict]:
    return [
        {"kind": "carriers", "body": {"carriers": [{"id": f"plan {number}"}]}},
        {"kind": "task", "body": {"id": f"task {number}", "period_s": 60.0}},
    ]


def phase(name: str, first: int, stop: int) -> dict:
    return {"kind": "phase", "name": name, "start": epoch(first), "stop": epoch(stop)}


def reference(source: str, **angles) -> dict:
    row = {"epoch": epoch(0), "yaw_deg": None, "roll_deg": None, "pitch_deg": None, **angles}
    return {"kind": "references", "body": {"source": source, "references": [row]}}


STAR_TRACKER = reference("star_tracker", yaw_deg=0.0, roll_deg=0.0, pitch_deg=0.0)
BEFORE = [
    {"kind": "spacecraft", "body": {"id": "sc"}},
    *plan(1),
    phase("quiet", 0, 10),
    STAR_TRACKER,
    rows(0, 9),
    hold(9, "quiet"),
    phase("turns", 10, 20),
    rows(10, 19),
    hold(19, "turns"),
]
ALIGNMENT = [phase("alignment", 20, 30), rows(20, 29), hold(29, "alignment")]
OPERATION = [phase("operation", 30, 60), rows(30, 39), hold(39, "operation")]
END = [{"kind": "end"}]


def reported(script: list[dict], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple]:
    stage = Stage()
    monkeypatch.setattr(demonstration, "GroundLink", lambda *_: Link(stage, script))
    monkeypatch.setattr(demonstration, "front_end", lambda *_: Station(stage))
    monkeypatch.setattr(demonstration, "_ARRIVAL_TIMEOUT_S", 0.3)
    run_story(tmp_path, ProcessAddresses("url", "key", ("host", 1), "resource"), Client(stage), lambda _scene: None)
    return stage.log


def positions(log: list[tuple], *names: str) -> list[int]:
    return [next(k for k, entry in enumerate(log) if entry[0] == name) for name in names]


def test_an_ordinary_story_needs_one_front_end(monkeypatch, tmp_path):
    log = reported([*BEFORE, *ALIGNMENT, *OPERATION, *END], monkeypatch, tmp_path)
    assert [entry for entry in log if entry[0] in {"start", "stop"}] == [("start", "task 1", "sa-1")]
    calibrate = next(entry[1] for entry in log if entry[0] == "calibrate")
    assert calibrate["source"] == "star_tracker"
    assert calibrate["turns"] == {"start": epoch(10), "stop": epoch(20)}
    assert positions(log, "calibrate", "align") == sorted(positions(log, "calibrate", "align"))


def test_a_new_plan_in_operation_replaces_the_front_end_once_its_rows_are_there(monkeypatch, tmp_path):
    script = [*BEFORE, *ALIGNMENT, *OPERATION, *plan(2), rows(40, 49), hold(49, "operation"), *END]
    log = reported(script, monkeypatch, tmp_path)
    changes = [entry for entry in log if entry[0] in {"start", "stop", "put_carriers"}]
    assert changes == [
        ("put_carriers", "sc", [{"id": "plan 1"}]),
        ("start", "task 1", "sa-1"),
        ("stop", epoch(39)),
        ("put_carriers", "sc", [{"id": "plan 2"}]),
        ("start", "task 2", "sa-1"),
    ]


def test_a_new_plan_before_the_alignment_finds_the_calibration_made(monkeypatch, tmp_path):
    log = reported([*BEFORE, *plan(2), *ALIGNMENT, *OPERATION, *END], monkeypatch, tmp_path)
    second = [k for k, entry in enumerate(log) if entry[0] == "put_carriers"][1]
    calibrate, align = positions(log, "calibrate", "align")
    assert calibrate < second < align
    assert [entry[0] for entry in log].count("calibrate") == 1


def test_another_analyzer_is_made_prime_after_its_first_row_and_the_old_one_before(monkeypatch, tmp_path):
    switch = [{"kind": "source", "body": {"source": "sa-2"}}, rows(40, 40), hold(40, "operation")]
    between = [rows(41, 49), hold(49, "operation")]
    back = [{"kind": "source", "body": {"source": "sa-1"}}, rows(50, 50), hold(50, "operation")]
    log = reported([*BEFORE, *ALIGNMENT, *OPERATION, *switch, *between, *back, *END], monkeypatch, tmp_path)
    seen = [entry for entry in log if entry[0] in {"start", "stop", "POST", "proceed"}][5:]
    assert seen == [
        ("stop", epoch(39)),
        ("start", "task 1", "sa-2"),
        ("proceed",),
        ("POST", "/spacecraft/sc/sources/sa-2:select", None),
        ("proceed",),
        ("stop", epoch(49)),
        ("start", "task 1", "sa-1"),
        ("POST", "/spacecraft/sc/sources/sa-1:select", None),
        ("proceed",),
    ]


def test_each_axis_is_calibrated_with_the_sensor_that_tells_it(monkeypatch, tmp_path):
    sensors = [reference("earth_sensor", roll_deg=0.0, pitch_deg=0.0), reference("radio_beacon", yaw_deg=0.0)]
    script = [line for line in BEFORE if line is not STAR_TRACKER]
    log = reported([*script[:4], *sensors, *script[4:], *ALIGNMENT, *OPERATION, *END], monkeypatch, tmp_path)
    expected = {"yaw": "radio_beacon", "roll": "earth_sensor", "pitch": "earth_sensor"}
    assert next(entry[1] for entry in log if entry[0] == "calibrate")["sources"] == expected
    assert next(entry[1] for entry in log if entry[0] == "align")["sources"] == expected
    assert {entry[2] for entry in log if entry[0] == "post_references"} == {"earth_sensor", "radio_beacon"}


def test_telemetry_is_forwarded_and_a_gap_is_not_waited_for(monkeypatch, tmp_path):
    body = {"records": [{"epoch": epoch(40), "onboard_mode": "inertial_forecast"}]}
    gap = [{"kind": "telemetry", "body": body}, rows(40, 49, is_gap=True), hold(49, "operation")]
    log = reported([*BEFORE, *ALIGNMENT, *OPERATION, *gap, *END], monkeypatch, tmp_path)
    assert ("POST", "/spacecraft/sc/telemetry:batch", body) in log
    assert [entry[0] for entry in log].count("proceed") == 5


ANNOUNCED = {
    "epoch": epoch(0),
    "period_s": 86_400.0,
    "constant_n_m": {"yaw": 0.0, "roll": 0.0, "pitch": 0.0},
    "cosine_n_m": {"yaw": 2e-6, "roll": 1e-6, "pitch": 3e-6},
    "sine_n_m": {"yaw": -1e-6, "roll": 4e-6, "pitch": 0.0},
}


class OrbitalFrameSpacecraft:
    """A spacecraft line that hands on nothing."""

    fed_forward: dict | None = ANNOUNCED

    def __init__(self, *_address) -> None:
        self.counters: list[int] = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def await_flown(self, _epoch):
        return []

    def send(self, _schedule, counter):
        self.counters.append(counter)


class Computing(Client):
    """A service that computes a command of each row that may be swept."""

    minute = 29

    def torques(self, _spacecraft_id):
        self.minute += 1
        self._stage.log.append(("torques", epoch(self.minute)))
        pulse = {"start": epoch(self.minute), "duration_s": 5.0, "yaw_n_m": 0.0, "roll_n_m": 0.002, "pitch_n_m": 0.0}
        control = {"allowed": True, "reasons": [{"code": "yaw_sign"}]}
        return {"attitude_epoch": epoch(self.minute), "schedule": [pulse], "control": control}


CATALOGUE = {"id": "sc", "onboard": {"fast_loop": True}, "control": {"mode": "ground", "release": "two_step"}}


def flown(record: OrbitalFrameSpacecraft, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[Stage, Story, list]:
    """Fly three rows of operation; the truth of each follows it."""
    stage, scenes = Stage(), []
    operation = [line for row in range(30, 33) for line in (hold(row, "operation"), rows(row, row))]
    script = [{"kind": "spacecraft", "body": CATALOGUE}, *BEFORE[1:], *ALIGNMENT, *operation, *END]
    monkeypatch.setattr(demonstration, "GroundLink", lambda *_: Link(stage, script))
    monkeypatch.setattr(demonstration, "SpacecraftLine", lambda *_: record)
    monkeypatch.setattr(demonstration, "front_end", lambda *_: Station(stage))
    endpoints = ProcessAddresses("url", "key", ("host", 1), "resource", uplink=("host", 2))
    return stage, run_story(tmp_path, endpoints, Computing(stage), scenes.append), scenes


def created(stage: Stage) -> dict:
    return next(entry[1] for entry in stage.log if entry[0] == "create_spacecraft")


def test_the_catalogue_states_what_the_craft_says_its_loop_feeds_forward(monkeypatch, tmp_path):
    stage, _, _ = flown(OrbitalFrameSpacecraft(), monkeypatch, tmp_path)
    assert created(stage)["control"] == {"mode": "ground", "release": "automatic"}
    onboard = created(stage)["onboard"]
    assert onboard == {
        "fast_loop": True,
        "fed_forward_torque": {**ANNOUNCED, "relative_error": 0.06, "axis_relative_error": 0.01},
    }
    # as the REST interface takes it, nothing of it lost
    site, inertia = {"latitude_deg": 55.0, "longitude_deg": 37.0}, [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]]
    plain = {"id": "a", "name": "A", "longitude_deg": 90.0, "receiving_site": site, "inertia_kg_m2": inertia}
    text = json.dumps({**plain, "torque_limit_n_m": 0.05, "onboard": onboard})
    taken = SpacecraftDocument.model_validate_json(text).to_record().onboard
    assert taken.residual_torque_n_m is None
    assert taken.fed_forward_torque is not None
    assert taken.fed_forward_torque.epoch_us == START_US
    assert taken.fed_forward_torque.sine_n_m.roll == 4e-6


def test_of_a_craft_that_says_nothing_nothing_is_stated(monkeypatch, tmp_path):
    record = OrbitalFrameSpacecraft()
    record.fed_forward = None
    stage, _, _ = flown(record, monkeypatch, tmp_path)
    assert created(stage)["onboard"] == CATALOGUE["onboard"]


def test_where_the_craft_is_flown_each_row_waits_for_the_command_of_the_one_before(monkeypatch, tmp_path):
    record = OrbitalFrameSpacecraft()
    stage, story, scenes = flown(record, monkeypatch, tmp_path)
    seen = [entry for entry in stage.log if entry[0] in {"proceed", "torques"}][3:]
    assert seen == [entry for row in range(30, 33) for entry in (("proceed",), ("torques", epoch(row)))]
    assert record.counters == [1, 2, 3]
    assert [scene.phase for scene in scenes] == ["start", "calibration", "alignment", "first_row", "operation"]
    assert scenes[-1].until == epoch(30), "the row whose truth was told"
    assert max(story.truth_deg) == START_US + 32 * MINUTE_US
