"""Sources of carriers for planning: a running service, or a spacecraft and a carrier plan on disk, beams assumed.

All end in the same document, that of ``GET .../carrier-selection``, and in the places of the stations; quiet days add
to it what they show.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer

from service.api.problems.problems import RequestProblemError
from service.api.schemas.calibrations import CarrierHarmonicAnswer
from service.api.schemas.carrier_selection import CarrierSelectionAnswer, Turns
from service.cli.importing.catalogue import carrier_names, read_orbit, read_plan, read_spacecraft
from service.cli.importing.folder import table_of
from service.cli.importing.manifest import NAME, WindowSection, read_manifest
from service.client.service_client import ServiceClient
from service.core.estimation.attitude_bound import WheelStatistics
from service.core.geometry.frames import AntennaDirection, station_direction
from service.errors import InvalidInputError
from service.formats.foreign.columns import PowersStatement, grouped, interpret_powers
from service.formats.foreign.table import Container, ForeignTableError, read_table
from service.pipeline.calibration.geometry_rows import CalibrationError
from service.pipeline.calibration.minute_rows import MinuteRows, minute_rows
from service.pipeline.config import CalibrationConfig, InterlockConfig
from service.pipeline.inputs.catalogue_checks import contradiction_of
from service.pipeline.planning import quiet_days
from service.pipeline.planning.assumed_beams import (
    NOISES,
    AssumedBeam,
    AssumedPayload,
    ContourPoint,
    assume_payload,
    contour_beams,
    offered_sites,
)
from service.pipeline.planning.planning import (
    WHEEL_PERIOD_S,
    Candidates,
    Recommendation,
    Rule,
    candidates_of,
    recommend,
    stated_wheels,
)
from service.pipeline.planning.rehearsal import Rehearsal, rehearse
from service.records.catalogue import CarrierPlan, Spacecraft
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, FloatArray, named_axes
from service.records.levels.measurement import MeasurementSeries
from service.runtime.clock import system_now_us
from service.runtime.jobs.analysis import CarrierRecommendation, wanted_count

#: share of unreadable rows beyond which a file is refused, longest gap that is no remark, s
_MOST_UNREADABLE, _GAP_S = 0.01, 1800.0
_CONTOUR_COLUMNS = ("transponder", "latitude_deg", "longitude_deg", "gain_db")


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

    def wheels(self, spacecraft: Spacecraft) -> WheelStatistics | None:
        """Return the wheels that the request or the spacecraft states."""
        figures = self.wheels_n_m_s, self.wheel_sigma_n_m_s
        return stated_wheels(spacecraft.onboard.momentum, *figures, self.wheel_period_s or WHEEL_PERIOD_S)


class QuietPowers(NamedTuple):
    """Powers of a file, and remarks on it."""

    rows: MinuteRows
    notes: tuple[str, ...]


def read_powers(path: Path, plan: CarrierPlan) -> QuietPowers:
    """Return the rows of a file in order of epoch.

    Raises
    ------
    InvalidInputError
        ``plan.quiet``: the file cannot be read, holds no carrier, several sources, or rows that mean nothing.
    """
    carriers = carrier_names([{"id": each.id, "name": each.name} for each in plan.carriers])
    try:
        stated, quiet = _stated(path)
        table = table_of(path, stated)
        read = interpret_powers(table, stated, carriers, system_now_us(), is_simulated=True)
    except (ForeignTableError, OSError) as error:
        raise InvalidInputError("plan.quiet", f"{path}: {error}") from None
    sources = set(table.column("source").to_pylist()) if "source" in table.header else set()
    if len(sources) > 1:
        raise InvalidInputError("plan.quiet", f"rows of {', '.join(sorted(sources))}; keep those of one source")
    # an age is nothing that a plan depends on
    asked = [each for each in read.questions if each.field != "last_day"]
    if asked or read.rows is None:
        detail = "; ".join(f"{each.field}: {each.text}" for each in asked)
        raise InvalidInputError("plan.quiet", f"{path}: the soo.yaml of its folder must state {detail}")
    rows = read.rows
    kept = np.ones(len(rows.lines), dtype=np.bool_)
    if quiet is not None:
        kept = (rows.epochs_us >= quiet.start) & (rows.epochs_us < quiet.stop)
    epochs_us, first = np.unique(rows.epochs_us[kept], return_index=True)
    levels = rows.values[kept][first]
    if not len(epochs_us):
        raise InvalidInputError("plan.quiet", f"no row of {path} lies in the quiet window")
    absent = [each for each, column in zip(plan.carrier_ids, levels.T, strict=True) if not np.isfinite(column).any()]
    series = MeasurementSeries(plan.carrier_ids, epochs_us, levels)
    notes = [
        *grouped(rows.faults),
        *(
            (f"{int(kept.sum()) - len(first)} rows repeat an epoch; the first of each counts",)
            if kept.sum() > len(first)
            else ()
        ),
        *(each for each in read.notes if each.startswith("no carrier of the plan")),
        *((f"carriers of the plan without powers: {', '.join(absent)}",) if absent else ()),
    ]
    return QuietPowers(minute_rows([series], plan.carrier_ids, ()), (*notes, *_gaps(series)))


def _gaps(series: MeasurementSeries) -> tuple[str, ...]:
    steps_s = np.diff(series.epochs_us) / US_PER_S
    long = np.flatnonzero(steps_s > _GAP_S)
    if not long.size:
        return ()
    worst = int(long[np.argmax(steps_s[long])])
    longest = f"the longest of {steps_s[worst] / 3600.0:.1f} h from {format_epoch(int(series.epochs_us[worst]))}"
    return (f"{len(long)} gaps beyond half an hour, {longest}",)


def _stated(path: Path) -> tuple[PowersStatement, WindowSection | None]:
    """Return what the manifest of a file's folder states of it, and the quiet window."""
    if (path.parent / NAME).exists():
        manifest = read_manifest(path.parent)
        for each in manifest.powers:
            if each.file == path.name:
                return each, manifest.windows.quiet
    return PowersStatement(file=path.name), None


def read_contours(path: Path) -> list[ContourPoint]:
    """Return the points of a contour file.

    Raises
    ------
    InvalidInputError
        ``plan.contours``: it cannot be read, or a cell means nothing.
    """
    points = []
    try:
        table = read_table(path, Container())
    except (ForeignTableError, OSError) as error:
        raise InvalidInputError("plan.contours", f"{path}: {error}") from None
    if sorted(table.header) != sorted(_CONTOUR_COLUMNS):
        wanted, found = ", ".join(_CONTOUR_COLUMNS), ", ".join(table.header[:8])
        raise InvalidInputError("plan.contours", f"{path}: the columns must be {wanted}; they are {found}")
    columns = [table.column(name).to_pylist() for name in _CONTOUR_COLUMNS]
    for line, name, *numbers in zip(table.lines.tolist(), *columns, strict=True):
        try:
            latitude_deg, longitude_deg, gain_db = (float(number) for number in numbers)
        except ValueError:
            raise InvalidInputError("plan.contours", f"{path}, line {line}: a cell is no number") from None
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 360.0 and np.isfinite(gain_db)):
            detail = f"{path}, line {line}: latitude {latitude_deg:g}, longitude {longitude_deg:g}, gain "
            detail += f"{gain_db:g} dB is no point of a beam; are latitude and longitude exchanged?"
            raise InvalidInputError("plan.contours", detail)
        points.append(ContourPoint(line, str(name), latitude_deg, longitude_deg, gain_db))
    if table.faults:
        raise InvalidInputError("plan.contours", f"{path}, line {table.faults[0][0]}: {table.faults[0][1]}")
    return points


#: share of the rehearsed rows with control allowed that makes a yes
_ENOUGH_ALLOWED = 0.9
_NO_POWERS = "the quiet days hold no level of it that a daily change can be fitted to"
_NO_ORBIT = "no ephemeris: the daily change is two harmonics of the sidereal day; state --ephemeris for the dish law"


class QuietPlanning(NamedTuple):
    """Document, and the rehearsal that figures are drawn from."""

    document: dict[str, Any]
    rehearsal: Rehearsal


def planned_by_quiet_days(
    spacecraft: Spacecraft,
    payload: AssumedPayload,
    plan: CarrierPlan,
    files: tuple[Path, Path | None],
    request: PlanRequest,
) -> QuietPlanning:
    """Return the recommendation for the noise of quiet days and stated or assumed beams.

    Raises
    ------
    InvalidInputError
        Files that cannot be read or do not fit, or days by which nothing can be rehearsed.
    """
    quiet_path, orbit_path = files
    powers = read_powers(quiet_path, plan)
    epochs_us = powers.rows.series.epochs_us
    span_us = int(epochs_us[0]), int(epochs_us[-1])
    try:
        orbit = quiet_days.sidereal_orbit(*span_us) if orbit_path is None else read_orbit(orbit_path)[1]
    except ForeignTableError as error:
        raise InvalidInputError("plan.ephemeris", f"{orbit_path}: {error}") from None
    contradiction = None if orbit_path is None else contradiction_of(orbit, spacecraft.longitude_deg)
    if contradiction is not None:
        raise InvalidInputError("plan.ephemeris", f"{orbit_path}: {contradiction}; check the satellite")
    if not (orbit.valid_start_us <= span_us[0] and span_us[1] <= orbit.valid_stop_us):
        reach = f"{format_epoch(orbit.valid_start_us)} to {format_epoch(orbit.valid_stop_us)}"
        detail = f"{orbit_path} reaches from {reach}, the quiet days begin at {format_epoch(span_us[0])}"
        raise InvalidInputError("plan.ephemeris", f"{detail} and end at {format_epoch(span_us[1])}")
    days = quiet_days.QuietDays(spacecraft, plan, orbit, powers.rows)
    levels = quiet_days.quiet_levels(days)
    suspected = quiet_days.suspected_turns(epochs_us, levels.residual_db, payload.response.slope)
    try:
        rehearsal = rehearse(days, levels, payload.response, far_yaw=request.far_yaw)
    except CalibrationError as error:
        hint = f" ({_turns_note(suspected)})" if suspected else ""
        raise InvalidInputError(
            "plan.quiet", f"{quiet_path}: a calibration was rehearsed and refused: {error}{hint}"
        ) from None
    candidates = _candidates(rehearsal, payload, plan, levels)
    count = wanted_count(candidates, request.count, "the carrier plan")
    offered = offered_sites(payload, candidates)
    yaw_scale = CalibrationConfig().criteria.yaw_scale
    recommendation = recommend(candidates, count, Rule(request.rule), yaw_scale=yaw_scale, offered=offered)
    notes = (*payload.assumptions, *powers.notes, *(() if orbit_path else (_NO_ORBIT,)))
    if suspected:
        notes += (_turns_note(suspected),)
    document = _document(CarrierRecommendation(None, None, count, recommendation, notes), request, spacecraft)
    document["quiet"] = {
        "file": quiet_path.name,
        "rows": len(epochs_us),
        "start": format_epoch(span_us[0]),
        "stop": format_epoch(span_us[1]),
        "days": (span_us[1] - span_us[0]) / 86.4e9,
        **_prediction(rehearsal),
        **_verdict(rehearsal, recommendation, suspected),
        "carriers": _carriers(candidates, levels),
    }
    return QuietPlanning(document, rehearsal)


def _candidates(
    rehearsal: Rehearsal, payload: AssumedPayload, plan: CarrierPlan, levels: quiet_days.QuietLevels
) -> Candidates:
    """Return the carriers of the rehearsed calibration; reasons of the plan, the beams and the file come first."""
    candidates = candidates_of(rehearsal.result, plan)
    is_absent: BoolArray = np.asarray(~np.isfinite(levels.residual_db).any(axis=0))
    refusals = [
        stated or ((_NO_POWERS,) if is_absent[k] else candidates.refusals[k])
        for k, stated in enumerate(payload.candidates.refusals)
    ]
    return replace(candidates, refusals=tuple(refusals))


def _carriers(candidates: Candidates, levels: quiet_days.QuietLevels) -> list[dict[str, Any]]:
    present = np.isfinite(levels.residual_db).mean(axis=0)
    return [
        {
            "carrier": name,
            "usable": not candidates.refusals[k],
            "reasons": list(candidates.refusals[k]),
            "present_share": float(present[k]),
            "white_db": _finite(candidates.noise.white_db[k]),
            "daily_change": json.loads(CarrierHarmonicAnswer.of(levels.harmonics[k]).model_dump_json()),
            "allan_db": [
                {"span_s": span_s, "deviation_db": _finite(levels.allan_db[number, k])}
                for number, span_s in enumerate(quiet_days.ALLAN_SPANS_S)
            ],
        }
        for k, name in enumerate(candidates.carrier_ids)
    ]


def _prediction(rehearsal: Rehearsal) -> dict[str, Any]:
    prediction = rehearsal.prediction
    stated = np.isfinite(prediction.protection_deg).any(axis=0)
    protection_deg = np.where(np.isfinite(prediction.protection_deg), prediction.protection_deg, np.inf)
    usual_deg, seldom_deg = (np.quantile(protection_deg, share, axis=0, method="higher") for share in (0.5, 0.95))
    return {
        "sigma_deg": _angles(np.array(prediction.usual_sigma_deg)),
        "protection_deg": _angles(np.where(stated, usual_deg, np.nan)),
        "protection_95_deg": _angles(np.where(stated, seldom_deg, np.nan)),
        "departure_deg": _angles(np.array(prediction.departure_deg)),
        "allowed_share": prediction.allowed_share,
        "inhibitions": dict(prediction.inhibitions),
        "rehearsed_turns": {
            "start": format_epoch(rehearsal.turns.start_us),
            "stop": format_epoch(rehearsal.turns.stop_us),
        },
    }


def _verdict(
    rehearsal: Rehearsal, recommendation: Recommendation, suspected: tuple[quiet_days.SuspectedTurn, ...]
) -> dict[str, Any]:
    """Return whether it could work, and one sentence with the reason."""
    share, sigma = rehearsal.prediction.allowed_share, rehearsal.prediction.usual_sigma_deg
    shortcomings = recommendation.sets["all"].shortcomings
    expected = f"sigma of yaw {sigma.yaw:.2f}, roll {sigma.roll:.3f}, pitch {sigma.pitch:.3f} deg"
    allowed = f"control allowed in {share:.1%} of the rehearsed rows"
    if suspected:
        return {"works": False, "verdict": f"Not to be told: {_turns_note(suspected)}"}
    if share < _ENOUGH_ALLOWED:
        reasons = sorted(rehearsal.prediction.inhibitions.items(), key=lambda each: -each[1])
        why = ", ".join(name for name, _count in reasons[:3])
        limits = InterlockConfig()
        wanted = f"roll below {limits.roll_sigma_limit_deg:g}, pitch below {limits.pitch_sigma_limit_deg:g} deg"
        return {"works": False, "verdict": f"No: {allowed} ({why}); {expected}; wanted: {wanted}"}
    if shortcomings:
        return {"works": False, "verdict": f"Not yet: {'; '.join(shortcomings)}; {expected}"}
    return {"works": True, "verdict": f"Yes: {expected}; {allowed}"}


def _turns_note(suspected: tuple[quiet_days.SuspectedTurn, ...]) -> str:
    """Return the hours that look like turns."""
    spans = [
        f"{format_epoch(one.window.start_us)} to {format_epoch(one.window.stop_us)} ({one.reach_deg:.2f} deg)"
        for one in suspected[:3]
    ]
    more = f" and {len(suspected) - 3} more" if len(suspected) > 3 else ""
    return f"the powers move as by turns of the satellite: {', '.join(spans)}{more}; leave these hours out of the file"


def _angles(values: FloatArray) -> dict[str, float | None]:
    """Return angles by name; null where there is none."""
    return {name: _finite(value) for name, value in named_axes(values)._asdict().items()}


def _finite(value: Any) -> float | None:
    """Return a number, None for NaN and infinity."""
    return float(value) if np.isfinite(value) else None


_BEAM_FORM = "[TRANSPONDER=]AZ,EL,WIDTH[,WIDTH_EL] in deg"


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
    rehearsal: Rehearsal | None = None


def planned_by_service(client: ServiceClient, spacecraft_id: str, request: PlanRequest) -> CarrierPlanning:
    """Return the recommendation of a service by its calibration."""
    spacecraft = client.spacecraft(spacecraft_id)
    wanted = asdict(request) | {"far_yaw": None, "turns": request.turns}
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
    count = wanted_count(payload.candidates, request.count, "the carrier plan")
    offered = offered_sites(payload, payload.candidates)
    recommendation = recommend(payload.candidates, count, Rule(request.rule), offered=offered)
    return _document(CarrierRecommendation(None, None, count, recommendation, payload.assumptions), request, spacecraft)


def _document(found: CarrierRecommendation, request: PlanRequest, spacecraft: Spacecraft) -> dict[str, Any]:
    """Return the document of ``GET .../carrier-selection``."""
    answer = CarrierSelectionAnswer.of(found.with_motion(spacecraft, request.wheels(spacecraft)), Turns(request.turns))
    document: dict[str, Any] = json.loads(answer.model_dump_json())
    return document


def _beam(text: str) -> tuple[str, Any]:
    """Return the transponder, ``*`` for all, and the beam that an option states."""
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
