"""``soo maintenance``: seals closed days and drops what retention no longer keeps, now; a running service may go on.

Exit codes: 0 done, 1 the archive of a spacecraft failed, 2 the option is wrong.
"""

import json
from typing import Annotated

import typer

from service.cli.command_group import end
from service.cli.operation.connection import JsonOption
from service.errors import StorageError

EXIT_FAULT = 1


def maintenance(
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL of the archive.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Seal closed days and drop what retention no longer keeps, as the service does by itself."""
    # the database costs time that other commands need not pay
    from service.composition.bootstrap import build_clock, build_maintenance, open_storage
    from service.composition.settings import Settings

    settings = Settings.model_validate({} if database is None else {"database_url": database})
    try:
        storage = open_storage(settings)
    except (StorageError, ValueError) as error:
        end(f"cannot use the database: {error}", cause=error)
    try:
        work = build_maintenance(settings, storage, build_clock(settings, storage))
        failed = work.do_all()
    finally:
        storage.close()
    dropped = {series: rows for series, rows in work.dropped_rows.items() if rows}
    if as_json:
        reported = {
            "sealed_rows": work.sealed_rows,
            "sealed_results": work.sealed_results,
            "dropped_rows": dropped,
            "failed_spacecraft": failed,
        }
        typer.echo(json.dumps(reported))
    else:
        typer.echo(f"sealed {work.sealed_rows} rows, {work.sealed_results} results")
        for series, rows in dropped.items():
            typer.echo(f"dropped {rows} rows of {series}")
    if failed:
        raise typer.Exit(EXIT_FAULT)
