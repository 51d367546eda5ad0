"""Bodies of the ground's lines: shaped like the bodies of the service's interface, made from a world."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from analyzer_sim.epochs import rfc3339
from analyzer_sim.streams import FloatArray
from analyzer_sim.world.ballistics import Ephemeris
from analyzer_sim.world.orbit import predicted_track
from analyzer_sim.world.payload.carriers import BANDS, ROLLOFF, SPAN_START_HZ, Carrier
from analyzer_sim.world.payload.effects import Operation
from analyzer_sim.world.payload.level_terms import SWEEP_RBW_HZ, SWEEP_TIME_S
from analyzer_sim.world.polarimeter import FIELD_T, FREQUENCY_HZ, SOURCE, PolarizationReport
from analyzer_sim.world.spacecraft.body import INERTIA_KG_M2
from analyzer_sim.world.spacecraft.spacecraft import Correction
from analyzer_sim.world.spacecraft.telemetry import TelemetryRecord, stated_profile
from analyzer_sim.world.world import LONGITUDE_DEG, World

Line = dict[str, Any]

SPACECRAFT_ID = "yamal-202"
TASK_ID = "yamal-202-ku"
SWEEP_ID = "ku"
SWEEP_POINTS = 2401
#: largest torque on the body about an axis
TORQUE_LIMIT_N_M = 0.05
AXES = ("yaw", "roll", "pitch")


def task(world: World, carriers: tuple[Carrier, ...]) -> Line:
    """Return the measurement task of the front end for some carriers of a world."""
    plan = world.plan
    sweep = {
        "id": SWEEP_ID,
        "start_hz": plan.span_hz[0],
        "stop_hz": plan.span_hz[1],
        "rbw_hz": SWEEP_RBW_HZ,
        "vbw_hz": 10.0 * SWEEP_RBW_HZ,
        "points": SWEEP_POINTS,
        "time_s": SWEEP_TIME_S,
        "detector": "RMS",
        "count": 1,
    }
    windows = [list(window) for window in plan.noise_windows_hz]
    measured = [
        {
            "id": carrier.id,
            "sweep": SWEEP_ID,
            "fc_hz": carrier.center_hz,
            "symbol_rate": None if carrier.is_beacon else carrier.symbol_rate_hz,
            "rolloff": ROLLOFF,
            "integ_bw_hz": carrier.bandwidth_hz,
            "kind": "beacon" if carrier.is_beacon else "modulated",
            "noise": windows,
            "limits": {"nominal_dbm": carrier.level_dbm, "warn_db": 2.0, "alarm_db": 4.0, "c_n0_min": 68.0},
        }
        for carrier in carriers
    ]
    levels = {
        "level_offset_db": 0.0,
        "freq_offset_hz": 0.0,
        "attenuation_db": 0.0,
        "ref_level_dbm": -20.0,
        "preamp": False,
    }
    period_s = world.scenario.row_period_s
    return {"id": TASK_ID, "period_s": period_s, "input": levels, "sweeps": [sweep], "carriers": measured}


def spacecraft_body(world: World, *, is_flown: bool = False) -> Line:
    """Return the body of the spacecraft."""
    site, keeping = world.plan.receiving_site, world.scenario.keeping
    # null: an operator who knows of no torque states none
    residual_n_m = 0.0 if world.scenario.is_torque_stated else None
    body: Line = {
        "id": SPACECRAFT_ID,
        "name": "Yamal-202 (simulated)",
        "cospar_id": "2003-053B",
        "longitude_deg": LONGITUDE_DEG,
        "simulated": True,
        "receiving_site": {
            "name": site.name,
            "latitude_deg": site.latitude_deg,
            "longitude_deg": site.longitude_deg,
            "height_m": site.height_m,
        },
        "inertia_kg_m2": np.diag(np.multiply(INERTIA_KG_M2, keeping.stated_inertia)).tolist(),
        "torque_limit_n_m": TORQUE_LIMIT_N_M,
        "onboard": {
            "fast_loop": True,
            "forecast_mode": True,
            "roll_yaw_coupling": keeping.is_coupling_announced,
            "residual_torque_n_m": residual_n_m,
            **_momentum(world, is_flown=is_flown),
            **_rate_sensor(world, is_flown=is_flown),
        },
        # torques do not reach a story that is only replayed, so none may count as applied
        "control": {"method": "robust", "mode": "ground", "release": "two_step"},
    }
    figures = world.scenario.polarimeter
    if figures is not None and not is_flown:
        stated = {
            "source": SOURCE,
            "feed_offset_deg": figures.feed_offset_deg,
            "frequency_hz": FREQUENCY_HZ,
            "field_t": FIELD_T,
            "white_deg": figures.white_deg,
            # with what a map leaves of the Faraday rotation
            "daily_deg": 0.04,
            "wander_deg": figures.wander_deg,
        }
        body["polarimeters"] = [stated]
    return body


def _momentum(world: World, *, is_flown: bool) -> Line:
    """Return what the catalogue says of the wheels: their errors and the torque that gathers in them alone."""
    figures = world.scenario.wheels
    if figures is None:
        return {}
    errors = {"sigma_n_m_s": figures.noise_n_m_s, "scale_error": figures.scale_error}
    # three times as wrong as stated where the story says so
    stated = {**errors, "misalignment_deg": 0.05, "pitch_bias_n_m_s": figures.bias_n_m_s, "used": True}
    if is_flown or not figures.is_profile_stated:
        # what acts on a flown body moves it too: it is the profile that is fed forward
        return {"momentum": stated}
    profile = stated_profile(figures, world.seed)
    parts = zip(("constant_n_m", "cosine_n_m", "sine_n_m"), profile, strict=True)
    torque = {
        "epoch": rfc3339(world.scenario.start_us),
        "period_s": 86_400.0,
        **{name: dict(zip(("roll", "pitch", "yaw"), part.tolist(), strict=True)) for name, part in parts},
        "relative_error": figures.profile_error,
        "axis_relative_error": figures.axis_profile_error,
    }
    return {"momentum": {**stated, "torque": torque}}


def _rate_sensor(world: World, *, is_flown: bool) -> Line:
    """Return what the catalogue says of the rate sensor; that of the flown spacecraft is the loop's own."""
    figures = world.scenario.rates
    if figures is None:
        return {}
    if is_flown:
        return {"rate_sensor": {"in_loop": True}}
    errors = ("bias_deg_h", "bias_tau_h", "noise_deg_sqrt_h")
    return {"rate_sensor": {"in_loop": False, **{name: getattr(figures, name) for name in errors}}}


def carrier_body(world: World, carrier: Carrier) -> Line:
    """Return one carrier of a plan; a beacon has neither station nor uplink."""
    offset_hz = carrier.center_hz - SPAN_START_HZ
    station, band, figures = carrier.station, BANDS[carrier.band], world.scenario.repeater
    controlled = "auto" if figures.is_power_control_announced else "unknown"
    return {
        "id": carrier.id,
        "name": "beacon" if carrier.is_beacon else f"{station.name} {carrier.symbol_rate_hz / 1e3:.0f}k",
        "station": None
        if carrier.is_beacon
        else {
            "name": station.name,
            "latitude_deg": station.latitude_deg,
            "longitude_deg": station.longitude_deg,
        },
        "band": band.name,
        "transponder": carrier.transponder,
        "polarization": carrier.polarization,
        "uplink_hz": None if carrier.is_beacon else band.uplink_base_hz + offset_hz,
        "downlink_hz": band.downlink_base_hz + offset_hz,
        "intermediate_hz": carrier.center_hz,
        "bandwidth_hz": carrier.bandwidth_hz,
        "kind": "beacon" if carrier.is_beacon else "traffic",
        "uplink_power_control": controlled if carrier.id in figures.power_controlled else "none",
        "transponder_mode": "alc" if carrier.transponder in figures.alc_transponders else "fixed_gain",
        "enabled": True,
    }


def ephemeris_body(world: World, ephemeris: Ephemeris) -> Line:
    """Return nodes, nodal period and predicted track with a day of margin on both sides."""
    track = predicted_track(
        ephemeris.orbit, world.seed, ephemeris.start_us, ephemeris.stop_us, name=ephemeris.stream_name
    )
    return {
        "ascending_nodes": [rfc3339(node_us) for node_us in ephemeris.nodes_us],
        "nodal_period_s": round(ephemeris.nodal_period_s, 3),
        "track": {
            "epochs": [rfc3339(epoch_us) for epoch_us in track.epochs_us.tolist()],
            "latitude_deg": track.latitude_deg.tolist(),
            "longitude_deg": track.longitude_deg.tolist(),
        },
    }


def operation_body(operation: Operation) -> Line:
    """Return the body of a declared operation."""
    body: Line = {
        "kind": operation.kind,
        "start": rfc3339(operation.start_us),
        "stop": rfc3339(operation.stop_us),
        "carriers": operation.carriers and list(operation.carriers),
        "transponders": operation.transponders and list(operation.transponders),
        "inhibit_control": operation.inhibit_control,
        "comment": operation.comment,
    }
    if operation.attitude_uncertainty_deg is not None:
        angles = zip(AXES, operation.attitude_uncertainty_deg, strict=True)
        body["attitude_uncertainty_deg"] = dict(angles)
    return body


def reference_bodies(world: World, start_us: int, stop_us: int) -> list[Line]:
    """Return the references of [start, stop), one body a sensor; an axis that a sensor does not tell is null."""
    reported = world.references
    first, stop = (int(row) for row in np.searchsorted(reported.epochs_us, [start_us, stop_us]))
    bodies = []
    for source in dict.fromkeys(reported.source[first:stop].tolist()):
        rows = [row for row in range(first, stop) if reported.source[row] == source]
        references = [
            {
                "epoch": rfc3339(int(reported.epochs_us[row])),
                **angles(reported.attitude_deg[row].tolist()),
                "sigma_deg": dict(zip(AXES, map(_present, reported.sigma_deg[row].tolist()), strict=True)),
            }
            for row in rows
        ]
        bodies.append({"source": source, "references": references})
    return bodies


def corrections_body(corrections: Sequence[Correction]) -> Line:
    """Return a batch of corrections."""
    entries = [
        {"start": rfc3339(one.start_us), "stop": rfc3339(one.stop_us), **angles(one.attitude_deg)}
        for one in corrections
    ]
    return {"corrections": entries}


def telemetry_body(record: TelemetryRecord) -> Line:
    """Return a batch of one record."""
    entry: Line = {"epoch": rfc3339(record.reported_us), "onboard_mode": record.onboard_mode}
    if record.wheel_momentum_n_m_s is not None:
        entry["wheel_momentum_n_m_s"] = list(record.wheel_momentum_n_m_s)
    entry["thrusters_active"] = record.thrusters_active
    if record.body_rate_deg_s is not None:
        entry["body_rate_deg_s"] = dict(zip(AXES, record.body_rate_deg_s, strict=True))
    return {"records": [entry]}


def polarization_body(report: PolarizationReport) -> Line:
    """Return a batch of one report of the polarimeter."""
    entry = {
        "epoch": rfc3339(report.reported_us),
        "ratio_db": report.ratio_db,
        "co_power_dbm": report.co_power_dbm,
        "noise_db": report.noise_db,
        "tec_tecu": report.tec_tecu,
    }
    return {"source": SOURCE, "records": [entry]}


def angles(attitude_deg: FloatArray | Iterable[float]) -> dict[str, float | None]:
    """Return yaw, roll, pitch by name; NaN is null."""
    return {f"{axis}_deg": _present(round(float(angle), 7)) for axis, angle in zip(AXES, attitude_deg, strict=True)}


def _present(value: float) -> float | None:
    return None if np.isnan(value) else value
