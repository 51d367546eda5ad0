"""Routes, one resource a file. ``ROUTERS`` stand under the base path and need a key, ``PUBLIC_ROUTERS`` do neither."""

from fastapi import APIRouter

from service.api.routes import (
    about,
    alarm_limits,
    alarms,
    alignments,
    analyses,
    attitude,
    audit,
    beams,
    calibrations,
    carrier_results,
    carrier_selection,
    carriers,
    closed_loop,
    control,
    ephemeris,
    export,
    handover,
    harmonics,
    health,
    inputs,
    jobs,
    keys,
    links,
    measurements,
    measurements_ingest,
    notes,
    operations,
    replays,
    samples,
    session,
    sources,
    spacecraft,
    status,
    stream,
    timeline,
    torque_commands,
    torques,
    traces,
)

ROUTERS: tuple[APIRouter, ...] = (
    # the first router is matched first: this one takes nearly all requests
    measurements_ingest.router,
    *(each.router for each in (spacecraft, carriers, ephemeris, sources, inputs, operations, calibrations, alignments)),
    *(
        each.router
        for each in (
            harmonics,
            carrier_selection,
            beams,
            status,
            measurements,
            samples,
            timeline,
            traces,
        )
    ),
    # torque_commands behind the names of torques, which its ids must not hide
    *(each.router for each in (attitude, carrier_results, torques, torque_commands, control, stream, export)),
    *(each.router for each in (replays, jobs)),
    links.report_router,
    links.router,
    alarms.list_router,
    *(each.router for each in (alarms, alarm_limits, notes, handover, keys, audit, analyses, closed_loop, about)),
)
PUBLIC_ROUTERS: tuple[APIRouter, ...] = (health.router, session.router)
