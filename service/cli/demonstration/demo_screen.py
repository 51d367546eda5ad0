"""Screen of ``soo demo``: progress, newest angles beside the truth, statistics of the operation."""

import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from service.cli.demonstration.persons import Person
from service.client.documents import Json, Verdict
from service.records.epoch import parse_epoch
from service.study.demonstration.demonstration import Scene
from service.study.demonstration.merit import AXES
from service.study.demonstration.replay_check import METHODS

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

    def announce(self, url: str, key_file: Path) -> None:
        """Print where the console is, and the file of the key that opens it."""
        self.key_file = key_file
        if self._with_table:
            text = f"console {url}/console/, sign in with the key in {key_file}"
            self._console.print(text, soft_wrap=True, highlight=False)

    def announce_persons(self, persons: tuple[Person, Person]) -> None:
        """Print who releases torques, and the files of their keys."""
        for person, task in zip(persons, ("prepares", "confirms"), strict=True):
            text = f"{person.name}, {person.role}, {task} torques with the key in {person.key_file}"
            self._console.print(text, soft_wrap=True, highlight=False)

    def show(self, scene: Scene) -> None:
        """Show one moment."""
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

    def open(self) -> None:
        """Start the progress bar; away from a terminal it would be noise."""
        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, console=self._console, disable=not self._console.is_terminal)
        self._task = self._progress.add_task(f"{'start':11s}", total=1.0)
        self._progress.start()

    def _show_progress(self, scene: Scene) -> None:
        """Move the progress bar along quiet days, turns, alignment and operation."""
        phases = scene.story.phases
        last = "alignment" if self._with_table else "operation"
        if self._progress is None or self._task is None or last not in phases:
            return
        start_us, stop_us = parse_epoch(phases["quiet"][0]), parse_epoch(phases[last][1])
        share = (parse_epoch(scene.until) - start_us) / (stop_us - start_us)
        self._progress.update(self._task, completed=share, description=f"{scene.phase:11s}")

    def _show_tracking(self, scene: Scene) -> None:
        """Show the newest angles, in place on a terminal, else every few seconds."""
        if self._progress is not None:
            self.close()
            self._say_where(scene)
        if self._console.is_terminal:
            if self._live is None:
                self._live = Live(console=self._console, auto_refresh=False)
                self._live.start()
            self._live.update(tracking_table(scene), refresh=True)
        elif time.monotonic() - self._printed_at >= _PRINT_EVERY_S:
            self._printed_at = time.monotonic()
            self._console.print(tracking_table(scene))

    def _say_where(self, scene: Scene) -> None:
        """Print the addresses of the service."""
        url = scene.client.service_url
        self._console.print(f"aligned after {time.monotonic() - self._began_at:.0f} s; tracking; Ctrl-C ends it")
        if self.key_file is not None:
            self._console.print(f"REST interface {url}/api/v1, described in {url}/docs; for example", soft_wrap=True)
            path = f"{url}/api/v1/spacecraft/{scene.story.spacecraft_id}/attitude"
            header = f'"Authorization: Bearer $(cat {self.key_file})"'
            self._console.print(f"  curl -H {header} {path}", soft_wrap=True, highlight=False)


def tracking_table(scene: Scene) -> Table:
    """Return the newest angles beside the truth, the torques and who is left out."""
    # angles are looked up by names that are put together
    attitude, paper = (Json(scene.client.attitude(scene.story.spacecraft_id, method)) for method in METHODS)
    torques = scene.client.torques(scene.story.spacecraft_id)
    truth = scene.story.truth_deg.get(parse_epoch(attitude["epoch"]))
    columns = ("axis", f"{METHODS[0]}, deg", "sigma, deg", "truth, deg", f"{METHODS[1]}, deg", "torque, N m")
    table = Table(*columns, title=attitude["epoch"])
    for k, axis in enumerate(AXES):
        table.add_row(
            axis,
            _signed(attitude[f"{axis}_deg"]),
            _signed(attitude["sigma_deg"][axis], sign=""),
            _signed(truth[k] if truth else None),
            _signed(paper[f"{axis}_deg"]),
            "-" if torques[f"{axis}_n_m"] is None else f"{torques[f'{axis}_n_m']:+.1e}",
        )
    control = attitude["control"]
    reasons = "; ".join([_verdict(control), *(reason["text"] for reason in control["reasons"])])
    out = ", ".join(f"{item['carrier']} ({item['reason']})" for item in attitude["excluded"]) or "none"
    table.caption = f"{reasons}; carriers excluded: {out}\nconsole: {scene.client.service_url}/console/"
    return table


def _verdict(control: Verdict) -> str:
    """Return which axes may be controlled; reasons beside an allowed control concern yaw."""
    if not control["allowed"]:
        return f"control not allowed ({control['state']})"
    return "roll and pitch: control allowed; yaw withheld" if control["reasons"] else "control allowed"


def _signed(value: float | None, sign: str = "+") -> str:
    """Return an angle with three decimals, a dash for none."""
    return "-" if value is None else f"{value:{sign}.3f}"


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
    """Print what control came to."""
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
