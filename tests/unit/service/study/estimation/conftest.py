"""A small world whose truth is chosen, and what a method is made to say of it."""

import numpy as np
import pytest

from service.records.calibration import Window
from service.records.catalogue import Ephemeris, Onboard, Site, Spacecraft
from service.study.estimation.bounds import measure_accuracy
from service.study.estimation.campaign import Course, Drawn, Unit, UnitResult
from service.study.estimation.flight.baselines import BASELINES
from service.study.estimation.flight.drive import Driven, MethodSeries
from service.study.estimation.flight.world import Ground, Truth, World
from service.study.estimation.measures import measure_method

MINUTE_US = 60_000_000
START_US = 1_800_000_000_000_000
ROWS, CARRIERS = 3000, 4
BITS = {
    name: 1 << bit
    for bit, name in enumerate(
        ("uplink_rain", "off", "step", "group_step", "interference", "wet_antenna", "eclipse", "gap")
    )
}


@pytest.fixture
def toured_world():
    """Fifty hours of minutes, an operation from its first row, and an attitude that swings on every axis."""
    epochs_us = START_US + MINUTE_US * np.arange(ROWS)
    angle = np.linspace(0.0, 24.0 * np.pi, ROWS)
    attitude = np.column_stack([0.25 * np.sin(angle), 0.2 * np.cos(angle), 0.2 * np.sin(1.7 * angle)])
    inertia = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
    ground = Ground(
        Spacecraft("sim", "sim", 90.0, Site(55.0, 37.0), inertia, 0.05, onboard=Onboard(fast_loop=True)),
        (),
        Ephemeris(1, (START_US,), 86_164.0, START_US, int(epochs_us[-1]), "nodes"),
        (),
        (),
        {"operation": Window(START_US, int(epochs_us[-1]) + MINUTE_US)},
        tuple(f"c{k}" for k in range(CARRIERS)),
        epochs_us,
        np.full((ROWS, CARRIERS), -60.0),
        np.ones(ROWS, dtype=bool),
        np.zeros(ROWS, dtype=np.int64),
        ("sa-1",),
        (),
    )
    truth = Truth(
        attitude,
        np.zeros(ROWS),
        np.zeros((ROWS, CARRIERS)),
        np.zeros((ROWS, CARRIERS), dtype=np.int64),
        BITS,
        np.zeros((CARRIERS, 3)),
        np.full(CARRIERS, 0.15),
        tuple(f"s{k}" for k in range(CARRIERS)),
        np.zeros((ROWS, CARRIERS)),
    )
    return World("octants", 1, 60.0, ground, truth)


@pytest.fixture
def said():
    """Make what a method says: its angles, and that control may go on."""

    def make(estimate_deg, sigma_deg=0.02, **changes):
        rows = len(estimate_deg)
        fields = {
            "estimate_deg": estimate_deg,
            "sigma_deg": np.full((rows, 3), sigma_deg),
            "is_axis_allowed": np.ones((rows, 3), dtype=bool),
            "is_control_allowed": np.ones(rows, dtype=bool),
            "is_fade": np.zeros(rows, dtype=bool),
            "is_alarm": np.zeros(rows, dtype=bool),
            "is_excluded": np.zeros((rows, CARRIERS), dtype=bool),
            "is_carrier_used": np.ones(CARRIERS, dtype=bool),
        }
        return MethodSeries(**{**fields, **changes})

    return make


@pytest.fixture
def driven_world():
    """Make what the product said of every row."""

    def make(methods):
        return Driven(np.arange(ROWS), START_US - MINUTE_US, np.zeros(3), methods)

    return make


@pytest.fixture
def judged_unit(toured_world, said, driven_world):
    """Make the result of a unit whose robust answer is right and whose paper answer is half of it."""

    def make(scenario="octants", seed=1, *, is_silent=False):
        world, truth = toured_world._replace(scenario=scenario, seed=seed), toured_world.truth.attitude_deg
        series = {"robust": said(truth), "paper": said(0.5 * truth, sigma_deg=0.1)}
        driven = driven_world(series)
        zero = measure_accuracy(np.zeros_like(truth), np.full_like(truth, np.nan), truth)
        drawn = {
            name: Drawn(one.estimate_deg.astype(np.float32), one.sigma_deg.astype(np.float32), one.is_control_allowed)
            for name, one in series.items()
        }
        hours = (np.arange(ROWS) / 60.0).astype(np.float32)
        if is_silent:
            return UnitResult(Unit(scenario, seed), 1.0, "calibration refused: no rows")
        return UnitResult(
            Unit(scenario, seed),
            1.0,
            "",
            {name: measure_method(world, driven, one) for name, one in series.items()},
            dict.fromkeys(BASELINES, zero),
            Course(hours, truth.astype(np.float32), np.zeros(ROWS, dtype=bool), drawn),
        )

    return make
