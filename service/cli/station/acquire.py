"""``soo acquire``: measure carrier powers on spectrum analyzers and send them to the service.

Exit codes: 0 ended by a signal (rows that the service has not taken stay in the spool, and are counted), 1 a thread
died, 2 the task or an option is wrong, or another process uses the spool. The key comes from the environment, never
from the command line.
"""

import logging
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from service.cli.command_group import state_folder
from service.cli.operation.connection import key_of, stored_key
from service.runtime.log_format import write_log


class EpochClock(StrEnum):
    """Whose clock stamps the rows."""

    ANALYZER = "analyzer"
    SYSTEM = "system"


def acquire(
    *,
    task_file: Annotated[
        Path | None, typer.Option("--task", help="Measurement task (JSON) of one analyzer.", dir_okay=False)
    ] = None,
    station_file: Annotated[
        Path | None, typer.Option("--station", help="Station file (JSON): several analyzers.", dir_okay=False)
    ] = None,
    spacecraft: Annotated[str | None, typer.Option(help="Spacecraft whose carriers are measured.")] = None,
    resource: Annotated[
        str | None, typer.Option(help="VISA resource name of the analyzer; in place of the task's.")
    ] = None,
    service: Annotated[str, typer.Option(help="Address of the service.")] = "http://127.0.0.1:8000",
    key_env: Annotated[str, typer.Option(help="Environment variable that holds the key.")] = "SOO_KEY",
    source: Annotated[str, typer.Option(help="Name of this source of measurements.")] = "sa-1",
    epoch: Annotated[EpochClock, typer.Option(help="Whose clock stamps the rows.")] = EpochClock.SYSTEM,
    period: Annotated[
        float | None,
        typer.Option(min=0.0, help="Seconds from row to row, 0 = as fast as it goes; default: the task's."),
    ] = None,
    batch_rows: Annotated[int, typer.Option(min=1, max=10_000, help="Rows of one request at most.")] = 100,
    batch_s: Annotated[
        float, typer.Option(min=0.0, help="Shortest time between requests that are not full, s; 0 = send at once.")
    ] = 0.05,
    hold_s: Annotated[
        float, typer.Option(min=0.0, help="Further wait for a sweep that a trigger or a simulator holds back, s.")
    ] = 0.0,
    spool: Annotated[
        Path | None,
        typer.Option(help="Folder where rows wait for the service; default: the state folder.", file_okay=False),
    ] = None,
    spool_days: Annotated[float, typer.Option(min=0.01, help="Days that a row waits at most.")] = 30.0,
    spool_mib: Annotated[float, typer.Option(min=0.1, help="Size of the rows that wait at most, MiB.")] = 1024.0,
    trace_period: Annotated[
        float, typer.Option(min=0.0, help="Seconds between two kept evidence traces of a sweep; inf = none.")
    ] = 10.0,
    evidence_traces: Annotated[int, typer.Option(min=0, help="Evidence traces that wait at most.")] = 1000,
    report_s: Annotated[
        float, typer.Option(min=0.0, help="Seconds between reports of the links; 0 = no reports.")
    ] = 5.0,
    check: Annotated[bool, typer.Option("--check", help="Show the plan and end.")] = False,
    json_log: Annotated[bool, typer.Option("--json-log", help="Log one JSON object a line.")] = False,
) -> None:
    """Measure carrier powers on spectrum analyzers and send them to the service."""
    # plans, spool and client cost half a second that a wrong option need not pay
    from service.cli.station.acquisition_run import Delivery, entries_of, log_summary, measure, planned_of, refuse
    from service.frontend.spool.file import Bounds
    from service.frontend.tasks.task_plan import StationEntry

    write_log("INFO", "json" if json_log else "text")
    if station_file is not None:
        entries = entries_of(station_file, task_file)
    elif task_file is not None and spacecraft is not None:
        entries = (
            StationEntry(
                task=task_file,
                spacecraft=spacecraft,
                source=source,
                resource=resource,
                period_s=period,
                epoch=epoch.value,
                hold_s=hold_s,
            ),
        )
    else:
        refuse("nothing to measure: give --task and --spacecraft, or --station")
    planned = planned_of(entries, is_quiet=json_log)
    if check:
        return
    key = key_of(key_env)
    if stored_key(key_env) is None:
        hint = "%s is read at the start alone; of a key file, named by %s_FILE, a replaced key is taken at once"
        logging.getLogger(__name__).info(hint, key_env, key_env)
    bounds = Bounds(rows_bytes=round(spool_mib * 2**20), age_s=spool_days * 86_400.0, traces=evidence_traces)
    folder = spool or state_folder("spool")
    delivery = Delivery(service, key, partial(stored_key, key_env), batch_rows, batch_s, folder, bounds, trace_period)
    for each, summary in zip(planned, measure(planned, delivery, report_s), strict=True):
        log_summary(each.entry, summary)
