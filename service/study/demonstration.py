"""Demonstration: simulator, front end and service as processes of their own, the whole chain over real sockets.

The simulator tells the ground's knowledge on its second port; it is forwarded through the public REST interface
before the rows it belongs to, as a control centre would. The truth comes the same way and goes to the judge only.
"""

import json
import math
import os
import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from service.client.service_client import ServiceClient
from service.records.attitude import BoolArray, FloatArray, IntArray
from service.records.epoch import parse_epoch
from service.study.archive_check import check_archive, check_replay, missed_promises
from service.study.ground_link import GroundLink
from service.study.merit import AXES, AxisMerit, judge_axis, missed_bounds
from service.study.processes import ChildProcess

#: wait for rows that are on their way, s
_ARRIVAL_TIMEOUT_S = 120.0
_POLL_S = 0.05
#: the trailing mean and the first slope must have filled, s of virtual time
_SETTLING_US = 3_600_000_000


@dataclass(frozen=True)
class Endpoints:
    """Where the three processes are reached."""

    service_url: str
    key: str
    ground: tuple[str, int]
    #: VISA resource name of the analyzer
    resource: str
    processes: tuple[ChildProcess, ...] = ()


@dataclass
class Story:
    """What the demonstration has been told so far."""

    spacecraft_id: str = ""
    phases: dict[str, tuple[str, str]] = field(default_factory=dict)
    #: epoch to angles (yaw, roll, pitch), deg
    truth_deg: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    catalogue: dict[str, Any] = field(default_factory=dict)
    #: one-row bound of the true beams with a common unknown, deg
    bound_deg: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Scene:
    """One moment of the demonstration, for whoever shows it."""

    phase: str
    until: str
    story: Story
    client: ServiceClient


#: called while rows arrive, and after each chunk of operation has its results
Show = Callable[[Scene], None]


@contextmanager
def simulated_station(directory: Path, *, seed: int, operation_days: float) -> Iterator[Endpoints]:
    """Start simulator and service, give their addresses, and end them."""
    key = secrets.token_urlsafe(24)
    environment = {**os.environ, "SOO_BOOTSTRAP_KEY": key, "SOO_KEY": key, "OPENBLAS_NUM_THREADS": "1"}
    simulator = [
        *("analyzer_sim", "serve", "--dialect", "rs", "--port", "0", "--ground-port", "0", "--await-ground"),
        *("--scenario", "demo", "--seed", str(seed), "--operation-days", str(operation_days)),
    ]
    database = f"sqlite:///{directory / 'soo.db'}"
    server = ["service", "serve", "--port", "0", "--clock", "data", "--database", database]
    with ExitStack() as stack:
        analyzer = stack.enter_context(
            ChildProcess("simulated analyzer", simulator, directory / "analyzer.log", environment)
        )
        service = stack.enter_context(ChildProcess("service", server, directory / "service.log", environment))
        ports = analyzer.announcement
        url = str(service.announcement["url"])
        resource = f"TCPIP::127.0.0.1::{ports['scpi_port']}::SOCKET"
        yield Endpoints(url, key, ("127.0.0.1", int(ports["ground_port"])), resource, (analyzer, service))


@contextmanager
def front_end(directory: Path, endpoints: Endpoints, story: Story) -> Iterator[ChildProcess]:
    """Start the front end on the measurement task that the story told."""
    task_path = directory / "task.json"
    task_path.write_text(json.dumps(story.catalogue["task"]))
    environment = {**os.environ, "SOO_KEY": endpoints.key, "OPENBLAS_NUM_THREADS": "1"}
    arguments = [
        *("service", "acquire", "--task", str(task_path), "--resource", endpoints.resource),
        *("--service", endpoints.service_url, "--spacecraft", story.spacecraft_id, "--epoch", "analyzer"),
        *("--period", "0", "--hold-s", "600", "--json-log"),
    ]
    with ChildProcess("front end", arguments, directory / "acquire.log", environment, announces=False) as process:
        yield process


def run_story(directory: Path, endpoints: Endpoints, client: ServiceClient, show: Show) -> Story:
    """Carry the story from the first line to the end of the scenario and return what was told."""
    story = Story()
    with ExitStack() as stack:
        link = stack.enter_context(GroundLink(*endpoints.ground))
        processes = list(endpoints.processes)
        for message in link.messages():
            _learn(story, client, message)
            if message["kind"] != "hold":
                continue
            if len(processes) == len(endpoints.processes):
                processes.append(stack.enter_context(front_end(directory, endpoints, story)))
            for process in processes:
                process.require_alive()
            if message["phase"] == "operation" and "calibration" not in story.catalogue:
                _calibrate_and_align(story, client, show)
            link.proceed()
            if message["phase"] == "operation":
                await_results(client, story.spacecraft_id, message["until"])
                show(Scene("operation", message["until"], story, client))
    return story


def _learn(story: Story, client: ServiceClient, message: dict[str, Any]) -> None:
    """Forward one line to the service; the truth is kept for the judge, the task for the front end."""
    kind = message["kind"]
    if kind == "phase":
        story.phases[message["name"]] = (message["start"], message["stop"])
    elif kind == "truth":
        for row in message["rows"]:
            story.truth_deg[parse_epoch(row["epoch"])] = (row["yaw_deg"], row["roll_deg"], row["pitch_deg"])
    elif kind == "bound":
        story.bound_deg = message["crlb_deg"]
    elif kind == "task":
        story.catalogue["task"] = message["body"]
    elif kind == "spacecraft":
        story.spacecraft_id = message["body"]["id"]
        client.create_spacecraft(message["body"])
    elif kind in _FORWARD:
        _FORWARD[kind](client, story.spacecraft_id, message["body"])


#: how each kind of line enters the service
_FORWARD: dict[str, Callable[[ServiceClient, str, dict[str, Any]], Any]] = {
    "carriers": lambda client, sc, body: client.put_carriers(sc, body["carriers"]),
    "ephemeris": lambda client, sc, body: client.put_ephemeris(sc, body),
    "references": lambda client, sc, body: client.post_references(sc, body["source"], body["references"]),
    "corrections": lambda client, sc, body: client.post_corrections(sc, body["corrections"]),
    "operations": lambda client, sc, body: client.post_operation(sc, body),
}


def _calibrate_and_align(story: Story, client: ServiceClient, show: Show) -> None:
    """Do what an operator does after the turns: calibrate, activate, align."""
    spacecraft_id = story.spacecraft_id
    windows = {name: {"start": start, "stop": stop} for name, (start, stop) in story.phases.items()}
    stop = story.phases["alignment"][1]
    _await_measurement(story, client, stop, show)
    show(Scene("calibration", stop, story, client))
    started = client.start_calibration(
        spacecraft_id,
        {"quiet": windows["quiet"], "turns": windows["turns"], "method": "paper", "source": "star_tracker"},
    )
    client.wait_job(started["job"])
    client.activate_calibration(spacecraft_id, started["id"])
    story.catalogue["calibration"] = client.calibration(spacecraft_id, started["id"])
    story.catalogue["alignment"] = client.align(spacecraft_id, {**windows["alignment"], "source": "star_tracker"})


def _await_measurement(story: Story, client: ServiceClient, stop: str, show: Show) -> None:
    """Wait until the last row before an epoch has arrived; the ground's messages run ahead of the rows."""
    row_period_us = 60_000_000
    deadline, former = time.monotonic() + _ARRIVAL_TIMEOUT_S, None
    while time.monotonic() < deadline:
        newest = client.status(story.spacecraft_id)["newest_measurement"]
        if newest is not None and newest != former:
            # a slow machine may take its time as long as rows arrive
            deadline, former = time.monotonic() + _ARRIVAL_TIMEOUT_S, newest
            if parse_epoch(newest) + row_period_us >= parse_epoch(stop):
                return
            began = [name for name, (start, _) in story.phases.items() if start <= newest]
            show(Scene(began[-1] if began else "start", newest, story, client))
        time.sleep(_POLL_S)
    message = f"the rows up to {stop} did not arrive, nothing new for {_ARRIVAL_TIMEOUT_S:.0f} s"
    raise TimeoutError(message)


def await_results(client: ServiceClient, spacecraft_id: str, until: str) -> None:
    """Wait until the row of an epoch has its attitude."""
    deadline = time.monotonic() + _ARRIVAL_TIMEOUT_S
    while time.monotonic() < deadline:
        status = client.status(spacecraft_id)
        newest = status["newest_attitude"]
        if newest is not None and newest >= until and status["pending"] == 0:
            return
        time.sleep(_POLL_S)
    message = f"no attitude of {until} within {_ARRIVAL_TIMEOUT_S:.0f} s"
    raise TimeoutError(message)


class TrackedAngles(NamedTuple):
    """Estimate and truth of the operation phase, row by row."""

    epochs_us: IntArray
    #: (T, 3) deg, yaw, roll, pitch; NaN = none
    estimate_deg: FloatArray
    truth_deg: FloatArray
    is_control_allowed: BoolArray


def tracked_angles(story: Story, client: ServiceClient, method: str) -> TrackedAngles:
    """Return what the service keeps of the operation phase beside the truth."""
    start, stop = story.phases["operation"]
    rows = list(client.attitude_history(story.spacecraft_id, start, stop, method=method))
    epochs_us = [parse_epoch(row["epoch"]) for row in rows]
    nothing = (float("nan"),) * 3
    return TrackedAngles(
        np.array(epochs_us, dtype=np.int64),
        np.array([[_number(row[f"{axis}_deg"]) for axis in AXES] for row in rows]).reshape(-1, 3),
        np.array([story.truth_deg.get(epoch_us, nothing) for epoch_us in epochs_us]).reshape(-1, 3),
        np.array([row["control_allowed"] for row in rows], dtype=np.bool_),
    )


def judge_story(story: Story, client: ServiceClient, method: str) -> dict[str, Any]:
    """Return the figures of the operation phase, of the answer that never moves, and of what the archive keeps."""
    tracked = tracked_angles(story, client, method)
    is_judged = tracked.epochs_us >= parse_epoch(story.phases["operation"][0]) + _SETTLING_US
    estimate, truth = tracked.estimate_deg[is_judged], tracked.truth_deg[is_judged]
    merits = {axis: judge_axis(estimate[:, k], truth[:, k]) for k, axis in enumerate(AXES)}
    zeros = {axis: judge_axis(np.zeros(len(truth)), truth[:, k]) for k, axis in enumerate(AXES)}
    allowed = tracked.is_control_allowed[is_judged]
    kept = check_archive(client, story.spacecraft_id, story.truth_deg)
    kept |= check_replay(client, story.spacecraft_id, story.phases["operation"], method)
    return {
        "method": method,
        "rows": len(tracked.epochs_us),
        "rows_judged": len(truth),
        "availability": round(float(allowed.mean()), 4) if len(allowed) else 0.0,
        "axes": {axis: _figures(merit) for axis, merit in merits.items()},
        "zero_answer": {axis: _figures(merit) for axis, merit in zeros.items()},
        "crlb_deg": story.bound_deg,
        **kept,
        "missed": missed_bounds(merits) + missed_promises(kept),
        "zero_answer_misses": missed_bounds(zeros),
    }


def _number(value: float | None) -> float:
    """Return a number, NaN for null."""
    return float("nan") if value is None else value


def _figures(merit: AxisMerit) -> dict[str, float | None]:
    """Return figures that print well; None where there was nothing to judge."""
    return {name: round(value, 4) if math.isfinite(value) else None for name, value in merit._asdict().items()}
