"""One run of ``soo demo``, from its addresses to its figures."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from service.cli.demonstration.demo_screen import Presenter
from service.cli.demonstration.persons import two_persons
from service.cli.operation.connection import DEFAULT_KEY_ENVIRONMENT, key_of
from service.client.problem import ClientError
from service.client.service_client import ServiceClient
from service.study.closed_loop.plant_process import PlantFailedError
from service.study.demonstration.control_centre import ControlCentre, SpacecraftLineError, TwoStepCentre
from service.study.demonstration.demonstration import (
    CentreOf,
    ProcessAddresses,
    Scene,
    Story,
    run_story,
    simulated_station,
)
from service.study.demonstration.judgement import (
    METHODS,
    FlightAlone,
    fly_alone,
    judge_control,
    judge_story,
    tracked_angles,
)
from service.study.demonstration.processes import ProcessFailedError

#: an answer may take so long on a machine that has much else to do, s
_PATIENCE_S = 60.0
#: a command is prepared to begin so late that persons have the whole life of a prepared command to confirm it
_TWO_STEP_SETTINGS = {"SOO_RELEASE__CONFIRM_S": "600"}
#: drawn into the folder of the demonstration when it is interrupted
FIGURE_NAME = "demonstration.png"
#: what ends a demonstration with a message in place of a trace
FAILURES = (ProcessFailedError, PlantFailedError, SpacecraftLineError, ClientError, TimeoutError, OSError)


def external(service: str, analyzer: str, ground: str, uplink: str | None) -> ProcessAddresses:
    """Return the addresses of processes that run already."""
    key = key_of(DEFAULT_KEY_ENVIRONMENT)
    host, port = _address(analyzer)
    spacecraft = _address(uplink) if uplink else None
    return ProcessAddresses(service, key, _address(ground), f"TCPIP::{host}::{port}::SOCKET", uplink=spacecraft)


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host, int(port)


class Alone(NamedTuple):
    """Reference flight of the same spacecraft without control."""

    seed: int
    operation_days: float
    #: None = those of the story
    quiet_days: float | None = None


def own_station(directory: Path, alone: Alone, release: str | None) -> AbstractContextManager[ProcessAddresses]:
    """Return simulator and service to be started; release None = nobody keeps the spacecraft."""
    return simulated_station(
        directory,
        seed=alone.seed,
        operation_days=alone.operation_days,
        quiet_days=alone.quiet_days,
        uplink=None if release is None else "ideal",
        settings=_TWO_STEP_SETTINGS if release == "two_step" else {},
    )


def play(
    directory: Path,
    endpoints: ProcessAddresses,
    presenter: Presenter,
    figure: Path | None,
    alone: Alone,
    *,
    is_two_step: bool = False,
) -> dict[str, Any]:
    """Run the story to its end and return its figures; an interruption leaves a drawn figure in the folder."""
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(1))
        client = stack.enter_context(ServiceClient(endpoints.service_url, endpoints.key, timeout_s=_PATIENCE_S))
        centre_of: CentreOf = ControlCentre
        if is_two_step:
            persons = two_persons(client, directory)
            presenter.announce_persons(persons)
            operator = ServiceClient(endpoints.service_url, persons[0].key, timeout_s=_PATIENCE_S)
            centre_of = partial(TwoStepCentre, operator=stack.enter_context(operator))

        def show(scene: Scene) -> None:
            if scene.phase == "operation" and scene.story.centre is not None and presenter.alone is None:
                presenter.alone = pool.submit(fly_alone, "demo", *alone)
            presenter.show(scene)

        try:
            story = run_story(directory, endpoints, client, show, centre_of)
        except KeyboardInterrupt:
            presenter.say_end()
            scene = presenter.scene
            if scene is not None and scene.phase == "operation" and find_spec("matplotlib") is not None:
                _draw(scene.story, client, _flown(presenter), figure or directory / FIGURE_NAME)
            raise
        finally:
            presenter.close()
        flown = _flown(presenter)
        loop = None if story.centre is None or flown is None else judge_control(story, story.centre.log, flown)
        figures = judge_story(story, client, loop)
        if figure is not None:
            _draw(story, client, flown, figure)
    return figures


def _flown(presenter: Presenter) -> FlightAlone | None:
    """Return the flight without control; None where nobody closes the loop."""
    return None if presenter.alone is None else presenter.alone.result()


def _draw(story: Story, client: ServiceClient, flown: FlightAlone | None, figure: Path) -> None:
    # matplotlib costs a second that only a figure needs
    from service.study.demonstration.figures import draw_control, draw_tracking

    tracked = {method: tracked_angles(story, client, method) for method in METHODS}
    if flown is None:
        draw_tracking(tracked, figure)
    else:
        draw_control(tracked[METHODS[0]], flown, figure)
