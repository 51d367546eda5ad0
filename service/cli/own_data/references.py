"""``soo references``: readings of an attitude sensor from CSV, Parquet, AEM or JSON.

Exit codes: 0 stored or known, or understood with ``--dry-run``, 1 the service refused the request or did not answer
(run the same command again), 2 the file is none of these, or something must be stated (standard error has the options),
3 rows could not be read or were refused.
"""

import shlex
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
)
from service.cli.own_data.document_file import EXIT_DIFFERENT, report, show
from service.cli.own_data.readings import check_readings, open_readings, send_readings, summary_of, survey_of

if TYPE_CHECKING:
    from service.formats.foreign.sensor import SensorProposal

app = new_app(help="Readings of an attitude sensor.", no_args_is_help=True)


class SensorName(StrEnum):
    """Sensor under which readings are stored."""

    STAR_TRACKER = "star_tracker"
    EARTH_SENSOR = "earth_sensor"
    RADIO_BEACON = "radio_beacon"
    OTHER = "other"


class ScalarEnd(StrEnum):
    """Position of the scalar of a quaternion."""

    FIRST = "first"
    LAST = "last"


@app.callback()
def group() -> None:
    """Store readings of an attitude sensor."""


@app.command()
def put(
    file: Annotated[Path, typer.Argument(help="CSV, Parquet, AEM or JSON file.", dir_okay=False, exists=True)],
    *,
    spacecraft: SpacecraftOption,
    source: Annotated[SensorName, typer.Option(help="Sensor of the readings.")] = SensorName.STAR_TRACKER,
    time_column: Annotated[
        list[str] | None, typer.Option(help="Column of the epochs; date and time: state both.")
    ] = None,
    time_format: Annotated[
        str | None, typer.Option(help="`iso`, `unix_s`, `unix_ms`, `unix_us`, or a pattern: %d.%m.%Y %H:%M:%S.")
    ] = None,
    tz: Annotated[
        str | None, typer.Option(help="Zone of epochs without an offset: UTC, +03:00, Europe/Moscow.")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the angles: deg, rad, mrad, arcmin or arcsec.")] = None,
    scalar: Annotated[ScalarEnd | None, typer.Option(help="Position of the scalar of quaternions.")] = None,
    map_: Annotated[list[str] | None, typer.Option("--map", help="NAME=AXIS: column, and yaw, roll or pitch.")] = None,
    sigma_deg: Annotated[
        list[str] | None, typer.Option(help="AXIS=DEG: one standard deviation of an axis, deg.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what is understood, store nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Store readings of a CSV, Parquet, AEM or JSON file."""
    from service.cli.own_data.foreign_file import stated_pairs
    from service.formats.foreign.layout import StatedLayout
    from service.formats.foreign.sensor import StatedSensor

    time = StatedLayout(tuple(time_column or ()), time_format, tz)
    columns = stated_pairs(map_ or [], "--map", "NAME=AXIS")
    stated = StatedSensor(time, unit, None if scalar is None else scalar.value, columns)
    sigma = _sigma(stated_pairs(sigma_deg or [], "--sigma-deg", "AXIS=DEG"))
    readings, understood = open_readings(
        file, source.value, stated, lambda proposal: _statement(file, spacecraft, proposal)
    )
    survey = survey_of(file, readings)
    with connected(service, key_env, timeout_s=60.0) as client:
        understood |= summary_of(survey)
        if not as_json:
            show(str(file), ((name, str(value)) for name, value in understood.items()))
        check_readings(file, survey, is_simulated=client.spacecraft(spacecraft).get("simulated", False))
        counts = {} if dry_run else send_readings(client, spacecraft, source.value, readings, sigma)
    sentence = ", ".join(f"{count} {name}" for name, count in counts.items()) or "nothing was stored"
    report(understood | counts, as_json=as_json, sentence=sentence)
    if survey.faults.rows or counts.get("refused"):
        raise typer.Exit(EXIT_DIFFERENT)


def _sigma(stated: dict[str, str]) -> dict[str, float]:
    """Return standard deviations by axis, or end."""
    from service.formats.foreign.sensor import AXES

    try:
        sigma = {axis: float(value) for axis, value in stated.items()}
    except ValueError as error:
        end(f"--sigma-deg: {error}", cause=error)
    wrong = [axis for axis, value in sigma.items() if axis not in AXES or not 0.0 < value <= 180.0]
    if wrong:
        end(f"--sigma-deg {wrong[0]}={stated[wrong[0]]}: write yaw, roll or pitch, and degrees above 0")
    return sigma


def _statement(file: Path, spacecraft: str, proposal: "SensorProposal") -> str:
    """Return what must be stated, and the command to complete."""
    lines = [f"{file}: this must be stated, it is not guessed:"]
    command = shlex.join(["soo", "references", "put", str(file), "--spacecraft", spacecraft])
    for option, text, choices, _ in proposal.questions:
        lines.append(f"  {option}: {text}" + (f" [{', '.join(choices[:20])}]" if choices else ""))
        command += f" {option} {'NAME=AXIS' if option == '--map' else option.removeprefix('--').upper()}"
    return "\n".join((*lines, "State it:", f"  {command}"))
