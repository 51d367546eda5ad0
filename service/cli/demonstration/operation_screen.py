"""One screen of the operation: where, how sure, within bounds since when, torque, and the same without control."""

from collections.abc import Mapping
from pathlib import Path

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from service.cli.shift.words import sentence
from service.client.documents import Attitude, Json
from service.records.epoch import US_PER_S, format_epoch, parse_epoch
from service.study.demonstration.closed_judgement import TRUTH_BOUNDS_DEG, FlightAlone, within_bounds_since_us
from service.study.demonstration.demonstration import Scene
from service.study.demonstration.merit import AXES
from service.study.demonstration.replay_check import METHODS

#: name of each phase in the tutorial
PHASE_NAMES = {
    "quiet": "1 Quiet days",
    "turns": "2 Calibration turns",
    "calibration": "2 Calibration",
    "alignment": "3 Alignment",
    # waits for the compiler where nothing has compiled the filter before
    "first_row": "4 Operation, first row",
    "operation": "4 Operation",
}


def operation_screen(scene: Scene, alone: FlightAlone | None, keys: Mapping[str, Path]) -> Group:
    """Return the screen of one moment.

    Parameters
    ----------
    scene : Scene
        Moment.
    alone : FlightAlone or None
        The same spacecraft without control; None while it has not been flown.
    keys : Mapping
        Files of the keys to sign in with, by name; empty for a service of somebody else.
    """
    spacecraft_id = scene.story.spacecraft_id
    attitude = scene.client.attitude(spacecraft_id)
    hours = _hours(scene, attitude)
    title = f"{spacecraft_id}  {attitude['epoch']}  {PHASE_NAMES['operation']}, {hours:.1f} h"
    lines = [_verdict(scene, attitude), Text(title), *_bounds_lines(scene, alone, hours)]
    table = _table(scene, attitude, None if alone is None else alone.angles_deg(hours))
    excluded = ", ".join(f"{item['carrier']} ({item['reason']})" for item in attitude["excluded"]) or "none"
    foot = [
        Text(f"carriers used {attitude['carriers_used']}, excluded: {excluded}"),
        Text(f"console {scene.client.service_url}/console/", style="bold"),
    ]
    files = [Text(f"{name:7s} {file}", overflow="fold") for name, file in keys.items()]
    return Group(*lines, table, *foot, *files)


def _verdict(scene: Scene, attitude: Attitude) -> Text:
    """Return the sentence of the console's view Now, of `soo status` and of `soo watch`."""
    client, spacecraft_id = scene.client, scene.story.spacecraft_id
    status = Json(client.status(spacecraft_id))
    said = sentence(status, Json(attitude), Json(client.control(spacecraft_id)))
    return Text(said, style="bold green" if status["control"]["allowed"] else "bold red")


def _bounds_lines(scene: Scene, alone: FlightAlone | None, hours: float) -> list[Text]:
    """Return since when the true attitude is within its bounds, and how long it stays there without control."""
    if scene.story.centre is None:
        return [Text("Nobody keeps the spacecraft: it follows its slews")]
    since_us = within_bounds_since_us(scene.story)
    if since_us is None:
        kept = Text("The true attitude is out of its bounds", style="red")
    else:
        kept_h = (max(scene.story.truth_deg) - since_us) / US_PER_S / 3600.0
        kept = Text(f"The true attitude is within its bounds since {format_epoch(since_us)[:16]}Z, {kept_h:.1f} h")
    if alone is None:
        return [kept, Text("Without control: being flown")]
    statistics = alone.statistics()
    left_h = statistics["hours_within_bounds"]
    without = f"stays for {statistics['hours']:.1f} h" if left_h is None else f"leaves them after {left_h:.1f} h"
    # its angles are dashes from then on
    flown = f"; it was flown for {alone.hours[-1]:.1f} h" if hours > alone.hours[-1] else ""
    return [kept, Text(f"Without control it {without}{flown}")]


def _table(scene: Scene, attitude: Attitude, alone_deg: tuple[float, ...] | None) -> Table:
    """Return estimate, truth, torque and the attitude without control, a row an axis."""
    is_flown = scene.story.centre is not None
    # angles are looked up by names that are put together
    driving, paper = Json(attitude), Json(scene.client.attitude(scene.story.spacecraft_id, METHODS[1]))
    torques = scene.client.torques(scene.story.spacecraft_id)
    truth = scene.story.truth_deg.get(parse_epoch(attitude["epoch"] or ""))
    columns = ("deg", "estimate", "sigma", "truth", "paper", *(("bound", "left alone") if is_flown else ()))
    table = Table(*columns, "torque, N m", box=box.SIMPLE_HEAD, show_edge=False)
    for k, axis in enumerate(AXES):
        flown = (f"{TRUTH_BOUNDS_DEG[axis]:.1f}", _signed(None if alone_deg is None else alone_deg[k]))
        torque_n_m = torques[f"{axis}_n_m"]
        table.add_row(
            axis,
            _signed(driving[f"{axis}_deg"]),
            _signed(driving["sigma_deg"][axis], sign=""),
            _signed(truth[k] if truth else None),
            _signed(paper[f"{axis}_deg"]),
            *(flown if is_flown else ()),
            "-" if torque_n_m is None else f"{torque_n_m:+.1e}",
        )
    return table


def _hours(scene: Scene, attitude: Attitude) -> float:
    """Return the time since the begin of the operation."""
    if attitude["epoch"] is None:
        return 0.0
    start_us = parse_epoch(scene.story.phases["operation"][0])
    return max(0.0, (parse_epoch(attitude["epoch"]) - start_us) / US_PER_S / 3600.0)


def _signed(value: float | None, sign: str = "+") -> str:
    """Return an angle with three decimals, a dash for none."""
    return "-" if value is None else f"{value:{sign}.3f}"
