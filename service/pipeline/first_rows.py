"""Rows of a made-up payload that compile what a row goes through, so that no first row of a spacecraft waits for it.

Run ``python -m service.pipeline.first_rows`` after an installation; it takes a minute, and a second where the machine
code is there already.
"""

from dataclasses import replace

import numpy as np

from service.core.estimation.filtering.advance import advance
from service.core.estimation.filtering.filter_model import (
    CarrierModel,
    FilterSettings,
    initial_gaussian,
    no_carriers,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model
from service.core.estimation.filtering.readings import frozen_readings, no_readings
from service.core.estimation.filtering.row_block import empty_block, empty_result
from service.core.estimation.paper import row as paper_row
from service.core.estimation.paper.downlink_fade import LIMITS
from service.core.estimation.paper.loop_observer import initial_estimate
from service.pipeline.carrier_model.expected_level import WRITE_LEVELS
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.compute_command import NO_CARRY, compute_command
from service.pipeline.estimation.paper.runner import TAKE_ROWS
from service.pipeline.inputs.known_motion import CommandedMotion, commanded_arrays
from service.records.catalogue import ControlSettings, Method, Onboard, Release, Site, Spacecraft
from service.records.levels.attitude import Axes, row_without_attitude

_MINUTE_US = 60_000_000
_CARRIERS = 8


def compile_rows() -> None:
    """Take rows of eight carriers by both methods, and compute their torques."""
    _filter_rows()
    _take_paper_rows()
    for release in (Release.TWO_STEP, Release.AUTOMATIC):
        _compute_command(release)


def _filter_rows() -> None:
    model, random = _payload(_CARRIERS), np.random.default_rng(1)
    sigma_deg, sigma_db = np.full(3, 0.01), np.full(model.carriers, 0.03)
    aligned = initial_gaussian(model, np.zeros(3), sigma_deg, sigma_db, drift_deg_h=(0.1, 0.1, 0.1))
    block = empty_block(1, _CARRIERS)
    block.rows["epoch_us"], block.carriers["deviation_db"] = _MINUTE_US, random.normal(0.0, 0.1, _CARRIERS)
    advance(filter_model(model), start(model, 0, aligned), block, empty_result(1, _CARRIERS))
    frozen_readings(no_readings(_CARRIERS), np.zeros(1, dtype=np.int64), np.zeros((1, _CARRIERS)))


def _take_paper_rows() -> None:
    slopes, parts = np.zeros((_CARRIERS, 3)), np.ones((_CARRIERS, 1))
    model = paper_row.PaperArrays(
        np.zeros(1, LIMITS),
        np.zeros(_CARRIERS, paper_row.CARRIER),
        slopes,
        slopes,
        slopes,
        parts,
        parts,
        np.eye(3),
        filter_model(no_carriers()),
    )
    estimate = initial_estimate(np.zeros(3), np.full(3, 0.01), FilterSettings())
    state = paper_row.initial_arrays(_CARRIERS, 0, *estimate)
    epochs_us, power_dbm = np.full(1, _MINUTE_US, dtype=np.int64), np.full((1, _CARRIERS), -50.0)
    block = paper_row.PaperBlock(epochs_us, np.zeros(1), power_dbm, is_late=False)
    levels, results = np.zeros((1, _CARRIERS), paper_row.LEVEL), np.zeros(1, paper_row.RESULT)
    WRITE_LEVELS(power_dbm, 0, np.zeros((_CARRIERS, 2)), epochs_us, 0, np.empty_like(power_dbm))
    TAKE_ROWS(model, state, paper_row.room(state, 1), commanded_arrays(CommandedMotion(0), 0), block, levels, results)


def _compute_command(release: Release) -> None:
    spacecraft = Spacecraft(
        "none",
        "none",
        0.0,
        Site(0.0, 0.0),
        ((3000.0, 0.0, 0.0), (0.0, 3000.0, 0.0), (0.0, 0.0, 3000.0)),
        0.01,
        control=ControlSettings(release=release),
        # without them nothing is planned
        onboard=Onboard(fast_loop=True, forecast_mode=True),
    )
    angles = Axes(0.01, 0.02, -0.01)
    row = replace(
        row_without_attitude(0, 0, 1, Method.ROBUST, ()),
        attitude_deg=angles,
        sigma_deg=angles,
        rates_deg_s=Axes(0.0, 0.0, 0.0),
        control_allowed=True,
        control_allowed_axes=(True, True, True),
    )
    if not compute_command(row, spacecraft, NO_CARRY, 60.0, TorqueConfig()).command.control_allowed:
        message = "the made-up row leads to no torque, so nothing that plans one was compiled"
        raise ValueError(message)


def _payload(carriers: int) -> CarrierModel:
    """Return a model of some carriers; its figures matter no more than that the filter runs."""
    across, one = np.linspace(-1.0, 1.0, carriers), np.ones(carriers)
    return CarrierModel(
        gradient_db_deg=np.column_stack([0.1 * across, 1.0 - across**2, across]),
        hessian_db_deg2=np.zeros((carriers, 3, 3)),
        rain_share=one,
        transponder=np.arange(carriers, dtype=np.int64) % 2,
        white_sigma_db=0.1 * one,
        coloured_sigma_db=0.05 * one[:, None],
        coloured_tau_s=3600.0 * one[:, None],
        reference_walk_db=0.01 * one,
        common_sigma_db=np.zeros(0),
        common_tau_s=np.zeros(0),
        coefficient_covariance=np.tile(1e-4 * np.eye(9), (carriers, 1, 1)),
    )


if __name__ == "__main__":
    compile_rows()
