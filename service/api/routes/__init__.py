"""Routes by subject. ``ROUTERS`` stand under the base path and need a key, ``PUBLIC_ROUTERS`` do neither."""

from fastapi import APIRouter

from service.api.routes import (
    access,
    archive,
    calibrations,
    catalogue,
    control,
    inputs,
    measurements,
    shift,
    stream,
)

ROUTERS: tuple[APIRouter, ...] = (
    # the first router is matched first: this one takes nearly all requests
    measurements.measurements_ingest_router,
    *(catalogue.spacecraft_router, catalogue.carriers_router, catalogue.ephemeris_router, catalogue.sources_router),
    *(inputs.inputs_router, inputs.operations_router, calibrations.calibrations_router),
    *(calibrations.alignments_router, calibrations.harmonics_router, calibrations.carrier_selection_router),
    *(control.status_router, measurements.measurements_router),
    *(archive.samples_router, archive.timeline_router, measurements.traces_router),
    # torque_commands behind the names of torques, which its ids must not hide
    *(control.attitude_router, control.carrier_results_router, control.torques_router, control.torque_commands_router),
    *(
        control.control_router,
        stream.router,
        archive.export_router,
        calibrations.replays_router,
        calibrations.jobs_router,
    ),
    *(shift.report_router, shift.links_router, shift.list_router, shift.alarms_router, shift.alarm_limits_router),
    *(shift.notes_router, shift.handover_router, access.keys_router, access.audit_router),
    access.about_router,
)
PUBLIC_ROUTERS: tuple[APIRouter, ...] = (access.health_router, access.session_router)
