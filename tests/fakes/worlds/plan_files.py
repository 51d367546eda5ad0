"""Files for ``soo plan`` of a world of the simulator: spacecraft, carriers, orbit, powers and points of the beams."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from analyzer_sim.world.orbit import antenna_frame_deg, orbital_from_earth, station_position_km
from analyzer_sim.world.payload.carriers import PLANS
from service.formats.carrier_plan_csv import write_carrier_plan
from service.records.catalogue import Carrier, Ephemeris
from service.records.epoch import format_epoch
from service.records.levels.measurement import MeasurementSeries
from service.study.estimation.flight.world import World

RADIUS_KM = 42_164.172


def write_plan_files(world: World, folder: Path, plan: str = "ku16") -> list[str]:
    """Write the files of a world's quiet days and return the options that name them."""
    ground = world.ground
    spacecraft = asdict(ground.spacecraft)
    document = {name: spacecraft[name] for name in ("id", "name", "longitude_deg", "receiving_site", "inertia_kg_m2")}
    document |= {"torque_limit_n_m": ground.spacecraft.torque_limit_n_m, "onboard": spacecraft["onboard"]}
    (folder / "spacecraft.json").write_text(json.dumps(document))
    (folder / "carriers.csv").write_text(write_carrier_plan(ground.carriers))
    (folder / "orbit.json").write_text(json.dumps(orbit_document(ground.ephemeris)))
    names = tuple(carrier.id for carrier in ground.carriers)
    write_powers(folder / "quiet.csv", ground.series(ground.phases["quiet"], names))
    write_contours(folder / "contours.csv", contour_rows(plan, ground.carriers, ground.spacecraft.longitude_deg))
    files = {"spacecraft-file": "spacecraft.json", "carriers-file": "carriers.csv", "contours": "contours.csv"}
    files |= {"quiet": "quiet.csv", "ephemeris": "orbit.json"}
    return [text for name, file in files.items() for text in (f"--{name}", str(folder / file))]


def orbit_document(ephemeris: Ephemeris) -> dict[str, object]:
    """Return an orbit as the interface has it."""
    track = ephemeris.track
    nodes = [format_epoch(node_us) for node_us in ephemeris.ascending_nodes_us]
    document: dict[str, object] = {"ascending_nodes": nodes, "nodal_period_s": ephemeris.nodal_period_s}
    if track is not None:
        epochs = [format_epoch(epoch_us) for epoch_us in track.epochs_us]
        document["track"] = {
            "epochs": epochs,
            "latitude_deg": track.latitude_deg,
            "longitude_deg": [(value + 180.0) % 360.0 - 180.0 for value in track.longitude_deg],
        }
    return document


def write_powers(path: Path, series: MeasurementSeries) -> None:
    """Write powers as ``soo put powers`` reads them."""
    lines = [",".join(("epoch", *(f"{name}_dbm" for name in series.carrier_ids)))]
    for epoch_us, powers in zip(series.epochs_us.tolist(), series.power_dbm.tolist(), strict=True):
        cells = ("" if np.isnan(power) else f"{power:.3f}" for power in powers)
        lines.append(",".join((format_epoch(epoch_us), *cells)))
    path.write_text("\n".join(lines) + "\n")


def contour_rows(plan: str, carriers: Iterable[Carrier], longitude_deg: float) -> list[tuple[str, float, float, float]]:
    """Return transponder, latitude, longitude and gain around every station, on a grid of two degrees."""
    steps = np.arange(-6.0, 7.0, 2.0)
    rows = {}
    for carrier in carriers:
        if carrier.station is None:
            continue
        for north in steps:
            for east in 2.0 * steps:
                latitude = 2.0 * round((carrier.station.latitude_deg + north) / 2.0)
                longitude = 2.0 * round((carrier.station.longitude_deg + east) / 2.0)
                if abs(latitude) < 78.0:
                    rows[carrier.transponder, latitude, longitude] = None
    east = np.radians(longitude_deg)
    satellite_km = RADIUS_KM * np.array([[np.cos(east), np.sin(east), 0.0]])
    stations_km = np.array([station_position_km(latitude, longitude) for _, latitude, longitude in rows])
    body = orbital_from_earth(satellite_km, np.array([[0.0, 0.0, 1.0]]))
    azimuth_deg, elevation_deg = (angles[0] for angles in antenna_frame_deg(body, satellite_km, stations_km))
    return [
        (*row, float(PLANS[plan].beams[row[0]].gain_db(azimuth_deg[k], elevation_deg[k]))) for k, row in enumerate(rows)
    ]


def write_contours(path: Path, rows: list[tuple[str, float, float, float]]) -> None:
    """Write points of gain."""
    lines = [f"{name},{latitude:g},{longitude:g},{gain_db:.2f}" for name, latitude, longitude, gain_db in rows]
    path.write_text("transponder,latitude_deg,longitude_deg,gain_db\n" + "\n".join(lines) + "\n")
