"""Lines of the simulator's ground as records of the service.

What ``docs/evidence/scenarios.md`` calls the ground's knowledge comes as JSON objects shaped like the bodies of the
REST interface. A study stands beside that interface and feeds the pipeline directly, so it reads them itself; the lines
come from a program of this repository and are taken at their word.
"""

from typing import Any

from service.formats.ephemeris import ephemeris_from_nodes
from service.records.catalogue import (
    AxisTorques,
    BodyRateSensor,
    Carrier,
    ControlMode,
    ControlSettings,
    Ephemeris,
    FedForwardTorque,
    Method,
    Onboard,
    Polarimeter,
    Release,
    Site,
    Spacecraft,
    Station,
    Track,
    WheelMomentum,
)
from service.records.epoch import parse_epoch
from service.records.inputs import Operation, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes

#: one JSON object
Body = dict[str, Any]


def read_spacecraft(body: Body) -> Spacecraft:
    """Return the spacecraft of a ``spacecraft`` line."""
    control = body["control"]
    first, second, third = (tuple(float(element) for element in row) for row in body["inertia_kg_m2"])
    return Spacecraft(
        id=body["id"],
        name=body["name"],
        longitude_deg=float(body["longitude_deg"]),
        receiving_site=Site(**body["receiving_site"]),
        inertia_kg_m2=(
            (first[0], first[1], first[2]),
            (second[0], second[1], second[2]),
            (third[0], third[1], third[2]),
        ),
        torque_limit_n_m=float(body["torque_limit_n_m"]),
        cospar_id=body["cospar_id"],
        simulated=body["simulated"],
        onboard=_onboard(body["onboard"]),
        polarimeters=tuple(Polarimeter(**stated) for stated in body.get("polarimeters", ())),
        control=ControlSettings(Method(control["method"]), ControlMode(control["mode"]), Release(control["release"])),
    )


def _onboard(body: Body) -> Onboard:
    """Return what the catalogue states of the spacecraft on board."""
    stated, rates = body.get("momentum"), body.get("rate_sensor")
    if rates is not None:
        body = {**body, "rate_sensor": BodyRateSensor(**rates)}
    if stated is None:
        return Onboard(**body)
    # a flown spacecraft states none: what gathers in its wheels is the profile that is fed forward
    torque = None if stated.get("torque") is None else read_torque(stated["torque"])
    return Onboard(**{**body, "momentum": WheelMomentum(**{**stated, "torque": torque})})


def read_torque(body: Body) -> FedForwardTorque:
    """Return the profile of a torque."""
    return FedForwardTorque(
        epoch_us=parse_epoch(body["epoch"]),
        period_s=body["period_s"],
        constant_n_m=AxisTorques(**body["constant_n_m"]),
        cosine_n_m=AxisTorques(**body["cosine_n_m"]),
        sine_n_m=AxisTorques(**body["sine_n_m"]),
        relative_error=body["relative_error"],
        axis_relative_error=body["axis_relative_error"],
    )


def read_carriers(body: Body) -> tuple[Carrier, ...]:
    """Return the carriers of a ``carriers`` line in their order."""
    return tuple(
        Carrier(**{**carrier, "station": None if carrier["station"] is None else Station(**carrier["station"])})
        for carrier in body["carriers"]
    )


def read_ephemeris(body: Body) -> Ephemeris:
    """Return the ephemeris of an ``ephemeris`` line."""
    reported = body["track"]
    track = Track(
        tuple(parse_epoch(epoch) for epoch in reported["epochs"]),
        tuple(reported["latitude_deg"]),
        tuple(reported["longitude_deg"]),
    )
    nodes_us = [parse_epoch(epoch) for epoch in body["ascending_nodes"]]
    return ephemeris_from_nodes(nodes_us, body["nodal_period_s"], track)


def read_operation(body: Body, number: int) -> Operation:
    """Return the operation of an ``operations`` line under a number of the study's own."""
    angles = body.get("attitude_uncertainty_deg")
    return Operation(
        id=number,
        kind=body["kind"],
        start_us=parse_epoch(body["start"]),
        stop_us=parse_epoch(body["stop"]),
        carriers=_names(body["carriers"]),
        transponders=_names(body["transponders"]),
        inhibit_control=body["inhibit_control"],
        attitude_uncertainty_deg=None if angles is None else Axes(**angles),
        comment=body["comment"],
    )


def read_telemetry(body: Body) -> tuple[TelemetryRecord, ...]:
    """Return the records of a ``telemetry`` line."""
    return tuple(
        TelemetryRecord(
            parse_epoch(record["epoch"]),
            record["onboard_mode"],
            tuple(record["wheel_momentum_n_m_s"]) if "wheel_momentum_n_m_s" in record else None,
            thrusters_active=record.get("thrusters_active"),
            body_rate_deg_s=Axes(**record["body_rate_deg_s"]) if "body_rate_deg_s" in record else None,
        )
        for record in body["records"]
    )


def read_polarization(body: Body) -> tuple[PolarizationRecord, ...]:
    """Return the records of a ``polarization`` line."""
    return tuple(
        PolarizationRecord(
            body["source"], parse_epoch(record["epoch"]), **{k: v for k, v in record.items() if k != "epoch"}
        )
        for record in body["records"]
    )


def _names(names: list[str] | None) -> tuple[str, ...] | None:
    """Return names as a record keeps them."""
    return None if names is None else tuple(names)
