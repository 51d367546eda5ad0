"""The demonstration: runs, merit and closed judgement."""

import json
import math

import numpy as np
import pytest

from service.api.schemas.catalogue import SpacecraftDocument
from service.records.epoch import format_epoch
from service.study.demonstration import demonstration
from service.study.demonstration.control_centre import AXES, ControlLog
from service.study.demonstration.demonstration import ProcessAddresses, Story, run_story
from service.study.demonstration.figures import draw_control
from service.study.demonstration.judgement import (
    TRUTH_BOUNDS_DEG,
    AxisMerit,
    FlightAlone,
    TrackedAngles,
    judge_axis,
    judge_control,
    missed_control,
    missed_figures,
    within_bounds_since_us,
)

MINUTE_US = 60_000_000
START_US = 1_793_491_200_000_000


def epoch(minute):
    return format_epoch(START_US + minute * MINUTE_US)


class Stage:
    """Everything that happens, in order."""

    def __init__(self):
        self.log: list[tuple] = []
        self.newest: str | None = None
        self.reported: str | None = None


class Link:
    """A ground port that says a script; rows are there as soon as they may be swept."""

    def __init__(self, stage, script):
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

    def __init__(self, stage):
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

    def __init__(self, stage):
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


def rows(first, last, **fields):
    angles = {"yaw_deg": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0}
    return {"kind": "truth", "rows": [{"epoch": epoch(k), **angles, **fields} for k in range(first, last + 1)]}


def hold(last, phase):
    return {"kind": "hold", "until": epoch(last), "phase": phase}


def plan(number):
    return [
        {"kind": "carriers", "body": {"carriers": [{"id": f"plan {number}"}]}},
        {"kind": "task", "body": {"id": f"task {number}", "period_s": 60.0}},
    ]


def phase(name, first, stop):
    return {"kind": "phase", "name": name, "start": epoch(first), "stop": epoch(stop)}


def reference(source, **angles):
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


def reported(script, monkeypatch, tmp_path):
    stage = Stage()
    monkeypatch.setattr(demonstration, "GroundLink", lambda *_: Link(stage, script))
    monkeypatch.setattr(demonstration, "front_end", lambda *_: Station(stage))
    monkeypatch.setattr(demonstration, "_ARRIVAL_TIMEOUT_S", 0.3)
    run_story(tmp_path, ProcessAddresses("url", "key", ("host", 1), "resource"), Client(stage), lambda _scene: None)
    return stage.log


def positions(log, *names):
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

    def __init__(self, *_address):
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


def flown(record, monkeypatch, tmp_path):
    """Fly three rows of operation; the truth of each follows it."""
    stage, scenes = Stage(), []
    operation = [line for row in range(30, 33) for line in (hold(row, "operation"), rows(row, row))]
    script = [{"kind": "spacecraft", "body": CATALOGUE}, *BEFORE[1:], *ALIGNMENT, *operation, *END]
    monkeypatch.setattr(demonstration, "GroundLink", lambda *_: Link(stage, script))
    monkeypatch.setattr(demonstration, "SpacecraftLine", lambda *_: record)
    monkeypatch.setattr(demonstration, "front_end", lambda *_: Station(stage))
    endpoints = ProcessAddresses("url", "key", ("host", 1), "resource", uplink=("host", 2))
    return stage, run_story(tmp_path, endpoints, Computing(stage), scenes.append), scenes


def created(stage):
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


TRUTH = 0.3 * np.sin(np.linspace(0.0, 12.0 * np.pi, 2000))
GOOD = AxisMerit(0.03, 0.06, 0.2, 0.9, 1.0)


def merits(**changes):
    return {axis: changes.get(axis, GOOD) for axis in AXES}


def test_the_truth_itself_is_perfect():
    found = judge_axis(TRUTH, TRUTH)
    assert (found.rms_deg, found.error_95_deg, found.skill) == (0.0, 0.0, 1.0)
    assert found.slope == pytest.approx(1.0, rel=1e-12)
    assert found.truth_rms_deg == pytest.approx(0.3 / math.sqrt(2), rel=1e-3)  # whole waves, 2000 samples


def test_a_scaled_and_shifted_answer_has_its_slope_and_error():
    found = judge_axis(0.5 * TRUTH + 0.1, TRUTH)
    assert found.slope == pytest.approx(0.5, rel=1e-9)
    # independent parts: 0.1 of offset and half the truth; the mean of the sine over whole waves is zero
    assert found.rms_deg == pytest.approx(math.hypot(0.1, 0.5 * found.truth_rms_deg), rel=1e-3)
    assert found.skill == pytest.approx(1.0 - (found.rms_deg / found.truth_rms_deg) ** 2, rel=1e-12)


def test_the_95_percent_error_is_a_quantile_of_the_size():
    error = np.concatenate([np.full(96, 0.01), np.full(4, -1.0)])
    truth = np.linspace(-0.2, 0.2, 100)
    assert judge_axis(truth + error, truth).error_95_deg == pytest.approx(0.01, abs=1e-12)


def test_rows_without_an_estimate_do_not_count():
    estimate = TRUTH.copy()
    estimate[::3] = np.nan
    assert judge_axis(estimate, TRUTH).rms_deg == 0.0


@pytest.mark.parametrize("present", [0, 1])
def test_nothing_to_judge_is_nan_and_misses_every_bound(present):
    estimate = np.full(10, np.nan)
    estimate[:present] = 0.1
    nothing = judge_axis(estimate, np.linspace(0, 1, 10))
    assert np.isnan(nothing).all()
    assert len(missed_figures(dict.fromkeys(AXES, nothing), "paper")) == 7


def test_the_answer_that_never_moves_misses_the_bounds():
    zero = judge_axis(np.zeros(len(TRUTH)), TRUTH)
    assert zero.skill == pytest.approx(0.0, abs=1e-12)
    missed = missed_figures(dict.fromkeys(AXES, zero), "paper")
    assert [text.split(" ")[0:2] for text in missed] == [
        ["roll", "rms"],
        ["roll", "slope"],
        ["pitch", "rms"],
        ["pitch", "slope"],
    ]


def test_good_figures_miss_nothing_and_bounds_are_inclusive():
    assert missed_figures(merits(), "paper") == []
    assert missed_figures(merits(), "robust") == []
    assert missed_figures(merits(roll=AxisMerit(0.08, 0.2, 0.12, 0.5, 1.0)), "paper") == []
    assert missed_figures(merits(roll=AxisMerit(0.03, 0.2, 0.12, 0.5, 1.04)), "robust") == []


@pytest.mark.parametrize(
    ("method", "axis", "changes", "text"),
    [
        ("paper", "roll", {"rms_deg": 0.081}, "roll rms 0.081 deg above 0.08"),
        ("paper", "pitch", {"rms_deg": 0.101}, "pitch rms 0.101 deg above 0.1"),
        ("paper", "roll", {"slope": 1.16}, "roll slope 1.160 not within 1 +- 0.15"),
        ("paper", "pitch", {"slope": 0.84}, "pitch slope 0.840 not within 1 +- 0.15"),
        ("paper", "yaw", {"truth_rms_deg": 0.119}, "yaw truth rms 0.119 deg below 0.12: too little moved"),
        ("robust", "roll", {"rms_deg": 0.031}, "roll rms 0.031 deg above 0.03"),
        ("robust", "pitch", {"slope": 0.94}, "pitch slope 0.940 not within 1 +- 0.05"),
        ("robust", "yaw", {"rms_deg": 0.181}, "yaw rms 0.181 deg above 0.18"),
        ("robust", "yaw", {"slope": 0.69}, "yaw slope 0.690 not within 1 +- 0.3"),
    ],
)
def test_each_bound_is_named_when_it_is_missed(method, axis, changes, text):
    assert missed_figures(merits(**{axis: GOOD._replace(**changes)}), method) == [text]


def test_yaw_of_the_paper_method_is_shown_and_not_bounded():
    assert missed_figures(merits(yaw=GOOD._replace(rms_deg=9.0, slope=0.0)), "paper") == []


def test_a_craft_that_is_kept_still_is_judged_by_its_errors_alone():
    still = AxisMerit(0.02, 0.04, 0.02, 0.0, 0.1)
    far = AxisMerit(0.5, 0.9, 0.02, -600.0, 0.1)
    assert missed_figures(merits(yaw=still, roll=still, pitch=still), "robust", is_moved=False) == []
    assert missed_figures(merits(yaw=still, roll=far, pitch=still), "robust", is_moved=False) == [
        "roll rms 0.500 deg above 0.03"
    ]
    assert len(missed_figures(merits(yaw=still, roll=still, pitch=still), "robust")) == 6


START = "2026-11-05T10:00:00Z"
JUDGED_US = 1_793_872_800_000_000
HOURS = np.arange(100) / 60.0
STILL = np.zeros((100, 3))
#: roll leaves its bound after an hour
ALONE = FlightAlone(HOURS, np.stack([0.0 * HOURS, 0.3 * HOURS, 0.0 * HOURS], axis=1))


def story(angles_deg):
    """Return a story with an hour before operation in which the spacecraft was turned far."""
    before = {JUDGED_US - 60_000_000 * k: (5.0, 5.0, 5.0) for k in range(1, 60)}
    rows = {JUDGED_US + 60_000_000 * k: tuple(row) for k, row in enumerate(angles_deg.tolist())}
    return Story(phases={"operation": (START, "2026-11-06T10:00:00Z")}, truth_deg={**rows, **before})


def test_the_figures_are_those_of_the_operation_alone():
    angles_deg = np.zeros((100, 3))
    angles_deg[:, 0] = np.linspace(-0.3, 0.1, 100)
    angles_deg[7, 1] = -0.15
    log = ControlLog(rows=100, inhibited_rows=3)
    log.inhibitions["fade"] = 3
    found = judge_control(story(angles_deg), log, ALONE)
    assert found["largest_deg"] == {"yaw": 0.3, "roll": 0.15, "pitch": 0.0}
    assert found["size_95_deg"]["yaw"] == pytest.approx(0.28, abs=0.002)
    assert found["size_95_deg"]["roll"] == 0.0
    assert (found["inhibited_share"], found["inhibited_rows"]) == (0.03, {"fade": 3})
    assert (found["missed"], missed_control(found)) == ([], [])


@pytest.mark.parametrize(("axis", "name"), list(enumerate(TRUTH_BOUNDS_DEG)))
def test_one_row_at_its_bound_misses_it(axis, name):
    angles_deg = np.zeros((100, 3))
    angles_deg[50, axis] = -TRUTH_BOUNDS_DEG[name]
    found = judge_control(story(angles_deg), ControlLog(), ALONE)
    assert found["missed"] == [
        f"true {name} reached {TRUTH_BOUNDS_DEG[name]:.3f} deg, not below {TRUTH_BOUNDS_DEG[name]}"
    ]
    assert missed_control(found) == found["missed"]


def test_a_craft_that_needs_no_control_proves_nothing():
    found = judge_control(story(np.zeros((100, 3))), ControlLog(), FlightAlone(HOURS, STILL))
    assert missed_control(found) == ["the spacecraft keeps its bounds without control"]
    assert found["control_off"]["hours_within_bounds"] is None
    assert missed_control(None) == []


def test_the_craft_left_alone_is_judged_by_the_same_bounds():
    found = ALONE.statistics()
    assert (found["hours"], found["hours_within_bounds"]) == (1.65, 1.0)
    assert found["largest_deg"] == {"yaw": 0.0, "roll": 0.495, "pitch": 0.0}
    assert found["missed"] == ["true roll reached 0.495 deg, not below 0.3"]


@pytest.mark.parametrize(("row", "since_row"), [(None, 0), (50, 51), (98, 99), (99, None)])
def test_the_bounds_are_kept_since_the_row_after_the_last_that_left_them(row, since_row):
    angles_deg = np.zeros((100, 3))
    if row is not None:
        angles_deg[row, 2] = TRUTH_BOUNDS_DEG["pitch"]
    wanted = None if since_row is None else JUDGED_US + 60_000_000 * since_row
    assert within_bounds_since_us(story(angles_deg)) == wanted


def test_the_attitude_without_control_is_that_of_the_same_time():
    assert ALONE.angles_deg(0.5) == pytest.approx((0.0, 0.15, 0.0))
    assert ALONE.angles_deg(1.65) == pytest.approx((0.0, 0.495, 0.0))
    assert ALONE.angles_deg(1.66) is None


def test_the_drawn_figure_is_written(tmp_path):
    tracked = TrackedAngles(JUDGED_US + 60_000_000 * np.arange(100), STILL, STILL + 0.1, STILL, HOURS < 1.0)
    draw_control(tracked, ALONE, tmp_path / "closed.png")
    assert (tmp_path / "closed.png").read_bytes().startswith(b"\x89PNG")
