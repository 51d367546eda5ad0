"""Screen of the demonstration: what each phase shows."""

import time
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from service.cli.demonstration.persons import Person, commands_to_try
from service.cli.shift.tables import SEVERITY_STYLES, sentence
from service.client.documents import Attitude, Json
from service.records.epoch import US_PER_S, format_epoch, parse_epoch
from service.study.demonstration.control_centre import AXES
from service.study.demonstration.demonstration import Scene
from service.study.demonstration.judgement import METHODS, TRUTH_BOUNDS_DEG, FlightAlone, within_bounds_since_us

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
    return Text(said, style=SEVERITY_STYLES[status["control"]["situation"]["severity"]])


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


#: seconds between two prints of the tracking table away from a terminal
_PRINT_EVERY_S = 3.0
_ROWS_A_CHUNK = 60.0


class Presenter:
    """Shows the story: a progress bar, and in place of it a table of angles while it tracks without an end.

    Parameters
    ----------
    console : Console
        Where to show it.
    rows_per_second : float
        Pace of tracking; 0 = as fast as it goes.
    with_table : bool
        Whether tracking is shown as a table.
    """

    def __init__(self, console: Console, rows_per_second: float, *, with_table: bool) -> None:
        self._console = console
        self._rows_per_second = rows_per_second
        self._with_table = with_table
        self._progress: Progress | None = None
        self._live: Live | None = None
        self._task: TaskID | None = None
        self._printed_at = 0.0
        self._began_at = self._shown_at = time.monotonic()
        #: holds the key of the demonstration's own service, made for this run
        self.key_file: Path | None = None
        self._greeting: list[str] = []
        #: who releases torques
        self._persons: tuple[Person, ...] = ()
        #: the same spacecraft without control, flown meanwhile
        self.alone: Future[FlightAlone] | None = None
        #: newest moment that was shown
        self.scene: Scene | None = None

    def announce(self, url: str, key_file: Path) -> None:
        """Note where the console is, and the file of the key that opens it; printed once there is a spacecraft."""
        self.key_file = key_file
        self._greeting = [f"console {url}/console/, sign in with the key in {key_file}"]

    def announce_persons(self, persons: tuple[Person, Person]) -> None:
        """Note who releases torques, and the files of their keys."""
        self._persons = persons
        for person, task in zip(persons, ("prepares", "confirms"), strict=True):
            self._greeting.append(f"{person.name}, {person.role}, {task} torques with the key in {person.key_file}")

    def show(self, scene: Scene) -> None:
        """Show one moment."""
        self.scene = scene
        while self._greeting and self._with_table:
            # the console of a catalogue without a spacecraft would have to be loaded again
            self._console.print(self._greeting.pop(0), soft_wrap=True, highlight=False)
        if scene.phase == "operation" and self._with_table:
            self._show_tracking(scene)
        else:
            self._show_progress(scene)
        if scene.phase == "operation" and self._rows_per_second > 0.0:
            # a chunk holds an hour of rows; where each row waits for a command it has used part of its time
            due_at = self._shown_at + _ROWS_A_CHUNK / self._rows_per_second
            time.sleep(max(0.0, due_at - time.monotonic()))
        self._shown_at = time.monotonic()

    def close(self) -> None:
        """End what moves on the screen."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None
        if self._live is not None:
            self._live.stop()
            self._live = None

    def say_end(self) -> None:
        """End what moves and say that the end has begun; flight and figure may take some seconds."""
        self.close()
        self._console.print("stopping")

    def open(self) -> None:
        """Start the progress bar; away from a terminal it would be noise."""
        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        # a bar that stayed above the operation would name a phase that is over
        self._progress = Progress(
            *columns, console=self._console, disable=not self._console.is_terminal, transient=self._with_table
        )
        self._task = self._progress.add_task(_phase_text("start"), total=1.0)
        self._progress.start()

    def _show_progress(self, scene: Scene) -> None:
        """Move the progress bar along quiet days, turns, alignment and operation."""
        phases = scene.story.phases
        last = "alignment" if self._with_table else "operation"
        if self._progress is None or self._task is None or last not in phases or not scene.until:
            return
        start_us, stop_us = parse_epoch(phases["quiet"][0]), parse_epoch(phases[last][1])
        share = (parse_epoch(scene.until) - start_us) / (stop_us - start_us)
        self._progress.update(self._task, completed=share, description=_phase_text(scene.phase))

    def _show_tracking(self, scene: Scene) -> None:
        """Show the newest angles, in place on a terminal, else every few seconds."""
        if self._progress is not None:
            self.close()
            self._invite(scene)
        if self._console.is_terminal:
            if self._live is None:
                self._live = Live(console=self._console, auto_refresh=False)
                self._live.start()
            self._live.update(self._operation(scene), refresh=True)
        elif time.monotonic() - self._printed_at >= _PRINT_EVERY_S:
            self._printed_at = time.monotonic()
            self._console.print(self._operation(scene))

    def _operation(self, scene: Scene) -> Group:
        alone = self.alone.result() if self.alone is not None and self.alone.done() else None
        keys = {} if self.key_file is None else {"key": self.key_file}
        keys |= {each.name: each.key_file for each in self._persons}
        return operation_screen(scene, alone, keys)

    def _invite(self, scene: Scene) -> None:
        """Print three commands to try, each in one line of any length, so that it can be copied whole."""
        self._console.print(f"aligned after {time.monotonic() - self._began_at:.0f} s; Ctrl-C ends it")
        if self.key_file is None:
            return
        self._console.print("Now try, in another terminal:")
        url, is_flown = scene.client.service_url, scene.story.centre is not None
        for purpose, command in commands_to_try(url, self.key_file, self._persons, is_flown=is_flown):
            self._console.print(f"# {purpose}", highlight=False)
            self._console.print(command, soft_wrap=True, highlight=False)


def _phase_text(phase: str) -> str:
    """Return the name of a phase, as long as the longest."""
    return f"{PHASE_NAMES.get(phase, phase):{max(map(len, PHASE_NAMES.values()))}s}"


def print_figures(console: Console, figures: dict[str, Any]) -> None:
    """Print the figures of the operation as a table."""
    title = f"{figures['rows_judged']} rows"
    names = ("rms_deg", "error_95_deg", "truth_rms_deg", "skill", "slope")
    table = Table("method", "axis", "rms, deg", "95 % error, deg", "truth rms, deg", "skill", "slope", title=title)
    for method, axes in ((METHODS[0], figures["axes"]), (METHODS[1], figures[METHODS[1]]["axes"])):
        for axis, merit in axes.items():
            table.add_row(method, axis, *("-" if merit[name] is None else f"{merit[name]:.3f}" for name in names))
    crlb = ", ".join(f"{axis} {value:.3f}" for axis, value in figures["crlb_deg"].items())
    table.caption = f"control allowed {figures['availability']:.1%} of the rows; one-row bound {crlb} deg"
    console.print(table)
    console.print(
        f"{figures['rows_archived']} rows in the archive, {figures['rows_lost']} lost; "
        f"{figures['replay_rows']} rows replayed, {figures['replay_rows_different']} differ from live"
    )
    if figures["closed_loop"] is not None:
        _print_loop(console, figures["closed_loop"])
        for text in figures["estimate_misses"]:
            console.print(f"not judged where the spacecraft is kept, a miss where it is not: {text}")
    for text in figures["missed"]:
        console.print(f"missed: {text}")


def _print_loop(console: Console, loop: dict[str, Any]) -> None:
    alone = loop["control_off"]
    columns = ("axis", "largest, deg", "95 %, deg", "bound, deg", "usual, deg", "impulse, N m s", "left alone, deg")
    table = Table(*columns, title="the true attitude, loop closed; usual: for 95 runs of 100")
    for axis, largest_deg in loop["largest_deg"].items():
        names = ("size_95_deg", "bounds_deg", "usual_bounds_deg", "impulse_n_m_s")
        values = (largest_deg, *(loop[name][axis] for name in names), alone["largest_deg"][axis])
        table.add_row(axis, *(f"{value:.3f}" for value in values))
    reported = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in loop["commands"].items() if count)
    table.caption = (
        f"commands: {reported}; control inhibited {loop['inhibited_share']:.1%} of the rows\n"
        f"without control within the bounds for {alone['hours_within_bounds']} of {alone['hours']} h"
    )
    console.print(table)
