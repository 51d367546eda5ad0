"""Sources of carriers for planning: a running service, or a spacecraft and a carrier plan on disk, beams assumed.

All end in the same document, that of ``GET .../carrier-selection``, and in the places of the stations; quiet days add
to it what they show.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import typer

from service.client.service_client import ServiceClient
from service.core.geometry.frames import AntennaDirection, station_direction
from service.errors import InvalidInputError
from service.records.catalogue import Spacecraft

if TYPE_CHECKING:
    from service.core.estimation.attitude_bound import WheelStatistics
    from service.pipeline.planning.rehearsal import Rehearsal

_BEAM_FORM = "[TRANSPONDER=]AZ,EL,WIDTH[,WIDTH_EL] in deg"


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Request for a carrier selection, to an archive or to a service."""

    #: None: sixteen, or all when there are fewer
    count: int | None
    rule: str
    far_yaw: bool
    #: momentum along pitch and noise of a record, N m s, and time between records, s; None: those of the catalogue
    wheels_n_m_s: float | None = None
    wheel_sigma_n_m_s: float | None = None
    wheel_period_s: float | None = None

    @property
    def turns(self) -> str:
        """Which turns the answer carries."""
        return "far_yaw" if self.far_yaw else "standard"

    def wheels(self, spacecraft: Spacecraft) -> "WheelStatistics | None":
        """Return the wheels that the request or the spacecraft states."""
        from service.pipeline.planning.candidates import WHEEL_PERIOD_S, stated_wheels

        figures = self.wheels_n_m_s, self.wheel_sigma_n_m_s
        return stated_wheels(spacecraft.onboard.momentum, *figures, self.wheel_period_s or WHEEL_PERIOD_S)


@dataclass(frozen=True, slots=True)
class PlanFiles:
    """Files to plan by without a service."""

    spacecraft: Path
    carriers: Path
    contours: Path | None = None
    quiet: Path | None = None
    ephemeris: Path | None = None


class CarrierPlanning(NamedTuple):
    """The document of a choice, and where the station of each of its carriers is seen; NaN = not seen."""

    name: str
    document: dict[str, Any]
    direction: AntennaDirection
    #: of quiet days
    rehearsal: "Rehearsal | None" = None


def planned_by_service(client: ServiceClient, spacecraft_id: str, request: PlanRequest) -> CarrierPlanning:
    """Return the recommendation of a service by its calibration."""
    spacecraft = client.spacecraft(spacecraft_id)
    wanted = {
        "count": request.count,
        "rule": request.rule,
        "turns": request.turns,
        "wheels_n_m_s": request.wheels_n_m_s,
        "wheel_sigma_n_m_s": request.wheel_sigma_n_m_s,
        "wheel_period_s": request.wheel_period_s,
    }
    stated = {name: value for name, value in wanted.items() if value is not None}
    document = client.request("GET", f"/spacecraft/{spacecraft_id}/carrier-selection", params=stated)
    stations = {carrier["id"]: carrier.get("station") for carrier in client.carriers(spacecraft_id)["carriers"]}
    positions = [stations.get(row["carrier"]) for row in document["carriers"]]
    return CarrierPlanning(spacecraft_id, document, _directions(positions, spacecraft["longitude_deg"]))


def planned_by_files(files: PlanFiles, beams: list[str], noise: str, request: PlanRequest) -> CarrierPlanning:
    """Return the recommendation for files, with assumed noise or that of quiet days.

    Raises
    ------
    InvalidInputError
        A file that cannot be read or understood, a beam of another form, or carriers that cannot be chosen from.
    ValueError
        Contours of another region.
    """
    # web framework and validation cost a quarter of a second that other commands need not pay
    from service.api.problems.problems import RequestProblemError
    from service.cli.importing.catalogue import read_plan, read_spacecraft
    from service.pipeline.planning.assumed_beams import NOISES, assume_payload
    from service.records.catalogue import CarrierPlan

    stated = dict(_beam(text) for text in beams)
    try:
        with _of_file(files.spacecraft):
            spacecraft = read_spacecraft(
                files.spacecraft, lambda text: typer.echo(f"warning: {text}", err=True)
            ).to_record()
        with _of_file(files.carriers):
            carriers = read_plan(files.carriers).to_records()
        stated |= _contour_beams(files.contours, carriers, spacecraft.longitude_deg)
        _require_known(stated, carriers)
        meant = NOISES[noise] if files.quiet is None else NOISES[noise]._replace(meaning=f"that of {files.quiet.name}")
        payload = assume_payload(carriers, spacecraft.longitude_deg, meant, stated)
        if files.quiet is None:
            return CarrierPlanning(spacecraft.id, _assumed_document(payload, request, spacecraft), payload.direction)
        from service.cli.planning.quiet_plan import planned_by_quiet_days

        plan = CarrierPlan(1, "", carriers)
        found = planned_by_quiet_days(spacecraft, payload, plan, (files.quiet, files.ephemeris), request)
    except RequestProblemError as error:
        fields = "; ".join(f"{field.pointer or '/'}: {field.detail}" for field in error.fields) or error.detail
        raise InvalidInputError(error.code, fields) from None
    return CarrierPlanning(spacecraft.id, found.document, payload.direction, found.rehearsal)


def _contour_beams(path: Path | None, carriers: Any, longitude_deg: float) -> dict[str, Any]:
    """Return the beams of a contour file, none without one."""
    if path is None:
        return {}
    from service.cli.planning.quiet_plan import read_contours
    from service.pipeline.planning.assumed_beams import contour_beams

    return dict(contour_beams(read_contours(path), carriers, longitude_deg))


def _require_known(beams: dict[str, Any], carriers: Any) -> None:
    """Refuse a beam of a transponder that the plan does not have."""
    known = {carrier.transponder for carrier in carriers}
    unknown = sorted(set(beams) - known - {"*"})
    if unknown:
        detail = f"no carrier passes through {unknown[0]!r}; the transponders are {', '.join(sorted(known))}"
        raise InvalidInputError("plan.beam", detail)


def _assumed_document(payload: Any, request: PlanRequest, spacecraft: Spacecraft) -> dict[str, Any]:
    """Return the document of carriers with assumed beams and noise."""
    from service.api.schemas.carrier_selection import CarrierSelectionAnswer, Turns
    from service.pipeline.planning.assumed_beams import offered_sites
    from service.pipeline.planning.planning import Rule, recommend
    from service.runtime.jobs.analysis import CarrierRecommendation, wanted_count

    count = wanted_count(payload.candidates, request.count, "the carrier plan")
    offered = offered_sites(payload, payload.candidates)
    recommendation = recommend(payload.candidates, count, Rule(request.rule), offered=offered)
    found = CarrierRecommendation(None, None, count, recommendation, payload.assumptions)
    found = found.with_motion(spacecraft, request.wheels(spacecraft))
    document: dict[str, Any] = json.loads(CarrierSelectionAnswer.of(found, Turns(request.turns)).model_dump_json())
    return document


def _beam(text: str) -> tuple[str, Any]:
    """Return the transponder, ``*`` for all, and the beam that an option states."""
    from service.pipeline.planning.assumed_beams import AssumedBeam

    name, equals, figures = text.rpartition("=")
    try:
        values = [float(figure) for figure in figures.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 4) or not np.isfinite(values).all() or min(values[2:]) <= 0.0 or (equals and not name):
        raise InvalidInputError("plan.beam", f"{text!r} is no beam; write {_BEAM_FORM}")
    azimuth_deg, elevation_deg, width_deg, *rest = values
    return name or "*", AssumedBeam(azimuth_deg, elevation_deg, width_deg, rest[0] if rest else width_deg)


@contextmanager
def _of_file(path: Path) -> Iterator[None]:
    """Name the file in what is raised within."""
    from service.formats.foreign.table import ForeignTableError

    try:
        yield
    except ForeignTableError as error:
        raise InvalidInputError("plan.file", f"{path}: {error}") from None


def _directions(positions: list[Any], longitude_deg: float) -> AntennaDirection:
    """Return where stations are seen from the satellite; NaN where there is none."""
    known = [
        (np.nan, np.nan) if position is None else (position["longitude_deg"], position["latitude_deg"])
        for position in positions
    ]
    longitudes, latitudes = np.array(known, dtype=np.float64).reshape(-1, 2).T
    return station_direction(longitudes, latitudes, np.zeros(len(known)), longitude_deg)
