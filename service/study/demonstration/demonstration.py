"""Demonstration: simulator, front end and service as processes of their own, the whole chain over real sockets.

The simulator tells the ground's knowledge on its second port; it is forwarded through the public REST interface
before the rows it belongs to, as a control centre would. The truth comes the same way and goes to the judge only.
A new carrier plan or another analyzer ends the front end once its rows have arrived; the next one starts on the new
task.
"""

import os
import secrets
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any

from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.records.epoch import format_epoch, parse_epoch
from service.records.storage import sqlite_url
from service.study.closed_loop.ground_knowledge import AXIS_RELATIVE_ERROR, RELATIVE_ERROR
from service.study.demonstration.control_centre import AXES, ControlCentre, SpacecraftLine
from service.study.demonstration.processes import ChildProcess, FrontEnd, GroundLink

#: wait for rows that are on their way, s
_ARRIVAL_TIMEOUT_S = 600.0
_POLL_S = 0.05
#: longest stretch without a row in a story, s
_LONGEST_PAUSE_S = 40 * 86_400


@dataclass(frozen=True)
class ProcessAddresses:
    """Addresses of the three processes."""

    service_url: str
    key: str
    ground: tuple[str, int]
    #: VISA resource name of the analyzer
    resource: str
    processes: tuple[ChildProcess, ...] = ()
    #: the spacecraft's uplink; None = the story is only replayed
    uplink: tuple[str, int] | None = None
    #: where the world of a spacecraft that is flown is changed for a time
    changes: tuple[str, int] | None = None


@dataclass
class Story:
    """Data that the demonstration has received so far."""

    spacecraft_id: str = ""
    phases: dict[str, tuple[str, str]] = field(default_factory=dict)
    #: epoch of every row that is swept to angles (yaw, roll, pitch), deg
    truth_deg: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    catalogue: dict[str, Any] = field(default_factory=dict)
    #: one-row bound of the true beams with a common unknown, deg
    bound_deg: dict[str, float] = field(default_factory=dict)
    #: first sensor of each axis
    sensors: dict[str, str] = field(default_factory=dict)
    #: the analyzer that measures, and those that have sent rows
    source: str = "sa-1"
    heard: set[str] = field(default_factory=set)
    #: newest row that may have been swept, microseconds UTC
    granted_us: int = 0
    #: who closes the loop; None = nobody
    centre: ControlCentre | None = None


@dataclass(frozen=True)
class Scene:
    """One moment of the demonstration, for its display."""

    phase: str
    #: newest row; empty = there is none yet
    until: str
    story: Story
    client: ServiceClient


#: called while rows arrive, and after each chunk of operation has its results
Show = Callable[[Scene], None]
#: makes the control centre of a spacecraft that is flown
CentreOf = Callable[[ServiceClient, SpacecraftLine], ControlCentre]


@contextmanager
def simulated_station(
    directory: Path,
    *,
    seed: int,
    operation_days: float,
    quiet_days: float | None = None,
    scenario: str = "demo",
    uplink: str | None = None,
    settings: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[ProcessAddresses]:
    """Start simulator and service, give their addresses, and end them; with an uplink the spacecraft is flown.

    `settings` are those of the service that differ from its defaults, by environment variable.
    """
    key = secrets.token_urlsafe(24)
    own = {"SOO_BOOTSTRAP_KEY": key, "SOO_KEY": key, "SOO_FUTURE_TOLERANCE_DATA_S": str(_LONGEST_PAUSE_S)}
    environment = {**os.environ, **own, **settings, "OPENBLAS_NUM_THREADS": "1"}
    simulator = [
        *("analyzer_sim", "serve", "--dialect", "rs", "--port", "0", "--ground-port", "0", "--await-ground"),
        *("--scenario", scenario, "--seed", str(seed), "--operation-days", str(operation_days)),
        *(("--quiet-days", str(quiet_days)) if quiet_days else ()),
        *(("--uplink-port", "0", "--change-port", "0", "--uplink", uplink) if uplink else ()),
    ]
    database = sqlite_url(str(directory / "soo.db"))
    server = ["service", "serve", "--port", "0", "--clock", "data", "--database", database]
    with ExitStack() as stack:
        analyzer = stack.enter_context(
            ChildProcess("simulated analyzer", simulator, directory / "analyzer.log", environment)
        )
        service = stack.enter_context(ChildProcess("service", server, directory / "service.log", environment))
        ports = analyzer.announcement
        url = str(service.announcement["url"])
        resource = f"TCPIP::127.0.0.1::{ports['scpi_port']}::SOCKET"
        host = "127.0.0.1"
        spacecraft = (host, int(ports["uplink_port"])) if uplink else None
        changes = (host, int(ports["change_port"])) if uplink else None
        ground = (host, int(ports["ground_port"]))
        yield ProcessAddresses(url, key, ground, resource, (analyzer, service), spacecraft, changes)


def front_end(directory: Path, endpoints: ProcessAddresses, spacecraft_id: str) -> FrontEnd:
    """Return the front end of a spacecraft, not yet started."""
    environment = {**os.environ, "SOO_KEY": endpoints.key, "OPENBLAS_NUM_THREADS": "1"}
    arguments = [
        *("--service", endpoints.service_url, "--spacecraft", spacecraft_id),
        *("--epoch", "analyzer", "--period", "0", "--hold-s", "600", "--json-log"),
        *("--spool", str(directory / "spool")),
    ]
    return FrontEnd(directory, endpoints.resource, arguments, environment)


def run_story(
    directory: Path,
    endpoints: ProcessAddresses,
    client: ServiceClient,
    show: Show,
    centre_of: CentreOf = ControlCentre,
) -> Story:
    """Carry the story from the first line to the end of the scenario and return what was reported."""
    story = Story()
    with ExitStack() as stack:
        link = stack.enter_context(GroundLink(*endpoints.ground))
        if endpoints.uplink is not None:
            story.centre = centre_of(client, stack.enter_context(SpacecraftLine(*endpoints.uplink)))
        station: FrontEnd | None = None
        for message in link.messages():
            if message["kind"] in _ENDS_A_TASK and station is not None and station.is_running:
                _await_rows(story, client, show)
                station.stop()
                if message["kind"] == "carriers" and "calibration" not in story.catalogue and _is_turned(story):
                    # what the turns taught belongs to the plan under which they were flown
                    _calibrate(story, client, show)
            _update(story, client, message, show)
            if message["kind"] != "hold":
                continue
            station = station or stack.enter_context(front_end(directory, endpoints, story.spacecraft_id))
            if not station.is_running:
                station.start(story.catalogue["task"], story.source)
            station.require_alive()
            for process in endpoints.processes:
                process.require_alive()
            _sweep_chunk(story, client, show, link, message)
    return story


#: lines after which the front end has something else to do
_ENDS_A_TASK = frozenset({"carriers", "source"})


def _sweep_chunk(story: Story, client: ServiceClient, show: Show, link: GroundLink, message: dict[str, Any]) -> None:
    """Let the rows of a chunk be swept; in operation wait for their results."""
    is_operation = message["phase"] == "operation"
    if is_operation and "alignment" not in story.catalogue:
        _await_rows(story, client, show)
        if "calibration" not in story.catalogue:
            _calibrate(story, client, show)
        _align(story, client, show)
    if is_operation and story.centre is not None and story.centre.is_shown():
        # the truth of a row follows it, and so does the display
        show(Scene("operation", format_epoch(story.granted_us), story, client))
    is_new_source = story.source not in story.heard
    if story.heard and not is_new_source:
        _select_source(story, client)
    link.proceed()
    story.granted_us = _last_granted_us(story, message)
    if story.heard and is_new_source:
        # the service knows a source by its rows; this chunk holds the first one
        _await_rows(story, client, show)
        _select_source(story, client)
    elif is_operation and story.centre is not None:
        story.centre.steer(story.spacecraft_id, message["until"])
    elif is_operation and story.granted_us:
        await_results(client, story.spacecraft_id, format_epoch(story.granted_us))
        show(Scene("operation", message["until"], story, client))
    story.heard.add(story.source)


def _last_granted_us(story: Story, hold: dict[str, Any]) -> int:
    """Return the newest row that may be swept: the last whose truth was told, or where that follows, the one held."""
    if hold["phase"] == "operation" and story.centre is not None:
        return parse_epoch(hold["until"])
    return max(story.truth_deg, default=0)


def _select_source(story: Story, client: ServiceClient) -> None:
    """Make the analyzer that measures the prime one, unless it is."""
    if story.catalogue.get("prime", story.source) != story.source:
        client.request("POST", f"/spacecraft/{story.spacecraft_id}/sources/{story.source}:select")
    story.catalogue["prime"] = story.source


def _update(story: Story, client: ServiceClient, message: dict[str, Any], show: Show) -> None:
    """Forward one line to the service; the truth is kept for the judge, the task for the front end."""
    kind = message["kind"]
    if kind in _KEEP:
        _KEEP[kind](story, message)
    if kind == "spacecraft":
        body = message["body"] if story.centre is None else _steered(message["body"], story.centre)
        story.spacecraft_id = _create(client, body)
        show(Scene("start", "", story, client))
    elif kind in _FORWARD:
        _FORWARD[kind](client, story.spacecraft_id, message["body"])


def _create(client: ServiceClient, body: dict[str, Any]) -> str:
    """Add a spacecraft under the first id that is free, for an archive that has been shown the story before."""
    for number in count(1):
        name = body["id"] if number == 1 else f"{body['id']}-{number}"
        try:
            client.create_spacecraft({**body, "id": name})
        except ProblemError as error:
            if error.code != "spacecraft.exists":
                raise
        else:
            return name
    raise AssertionError  # the numbers have no end


def _steered(body: dict[str, Any], centre: ControlCentre) -> dict[str, Any]:
    """Return the catalogue entry of a spacecraft whose commands are taken to it, with what its loop feeds forward."""
    onboard = body["onboard"]
    if centre.line.fed_forward is not None:
        errors = {"relative_error": RELATIVE_ERROR, "axis_relative_error": AXIS_RELATIVE_ERROR}
        onboard = {**onboard, "fed_forward_torque": {**centre.line.fed_forward, **errors}}
    return {**body, "control": {**body["control"], "release": centre.release}, "onboard": onboard}


def _keep_truth(story: Story, message: dict[str, Any]) -> None:
    """Keep the rows that are swept; those of a gap never reach the service."""
    for row in message["rows"]:
        if not row.get("is_gap"):
            story.truth_deg[parse_epoch(row["epoch"])] = (row["yaw_deg"], row["roll_deg"], row["pitch_deg"])


def _keep_sensors(story: Story, message: dict[str, Any]) -> None:
    body = message["body"]
    for axis in AXES:
        if any(row[f"{axis}_deg"] is not None for row in body["references"]):
            story.sensors.setdefault(axis, body["source"])


#: what is remembered of each kind of line
_KEEP: dict[str, Callable[[Story, dict[str, Any]], Any]] = {
    "phase": lambda story, line: story.phases.update({line["name"]: (line["start"], line["stop"])}),
    "truth": _keep_truth,
    "references": _keep_sensors,
    "bound": lambda story, line: story.bound_deg.update(line["crlb_deg"]),
    "task": lambda story, line: story.catalogue.update(task=line["body"]),
    "source": lambda story, line: setattr(story, "source", line["body"]["source"]),
}
#: how each kind of line enters the service
_FORWARD: dict[str, Callable[[ServiceClient, str, dict[str, Any]], Any]] = {
    "carriers": lambda client, sc, body: client.put_carriers(sc, body["carriers"]),
    "ephemeris": lambda client, sc, body: client.put_ephemeris(sc, body),
    "references": lambda client, sc, body: client.post_references(sc, body["source"], body["references"]),
    "corrections": lambda client, sc, body: client.post_corrections(sc, body["corrections"]),
    "operations": lambda client, sc, body: client.post_operation(sc, body),
    "telemetry": lambda client, sc, body: client.request("POST", f"/spacecraft/{sc}/telemetry:batch", body),
    "polarization": lambda client, sc, body: client.post_polarization(sc, body["source"], body["records"]),
}


def _is_turned(story: Story) -> bool:
    """Return whether the last row of the turns has been granted."""
    period_us = round(1e6 * story.catalogue["task"]["period_s"])
    return "turns" in story.phases and story.granted_us + period_us >= parse_epoch(story.phases["turns"][1])


def _calibrate(story: Story, client: ServiceClient, show: Show) -> None:
    """Do what an operator does after the turns: calibrate and activate."""
    spacecraft_id = story.spacecraft_id
    windows = {name: {"start": start, "stop": stop} for name, (start, stop) in story.phases.items()}
    show(Scene("calibration", format_epoch(story.granted_us), story, client))
    request = {"quiet": windows["quiet"], "turns": windows["turns"], "method": "geometry", **_sensor_choice(story)}
    started = client.start_calibration(spacecraft_id, request)
    client.wait_job(started["job"])
    client.activate_calibration(spacecraft_id, started["id"])
    story.catalogue["calibration"] = client.calibration(spacecraft_id, started["id"])


def _align(story: Story, client: ServiceClient, show: Show) -> None:
    """Align over the phase that is meant for it."""
    show(Scene("alignment", format_epoch(story.granted_us), story, client))
    start, stop = story.phases["alignment"]
    request = {"start": start, "stop": stop, **_sensor_choice(story)}
    story.catalogue["alignment"] = client.align(story.spacecraft_id, request)
    show(Scene("first_row", format_epoch(story.granted_us), story, client))


def _sensor_choice(story: Story) -> dict[str, Any]:
    """Return one sensor for all axes, or one for each."""
    names = set(story.sensors.values())
    return {"source": names.pop()} if len(names) == 1 else {"sources": dict(story.sensors)}


def _await_rows(story: Story, client: ServiceClient, show: Show) -> None:
    """Wait until every row that was granted has arrived; the ground's messages run ahead of the rows."""
    deadline, former = time.monotonic() + _ARRIVAL_TIMEOUT_S, None
    while time.monotonic() < deadline:
        newest = client.status(story.spacecraft_id)["newest_measurement"]
        if newest is not None and newest != former:
            # a slow machine may take its time as long as rows arrive
            deadline, former = time.monotonic() + _ARRIVAL_TIMEOUT_S, newest
            if parse_epoch(newest) >= story.granted_us:
                return
            began = [name for name, (start, _) in story.phases.items() if start <= newest]
            show(Scene(began[-1] if began else "start", newest, story, client))
        time.sleep(_POLL_S)
    until = format_epoch(story.granted_us)
    message = f"the rows up to {until} did not arrive, nothing new for {_ARRIVAL_TIMEOUT_S:.0f} s"
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
