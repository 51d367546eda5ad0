"""A unit whose world breaks the product tells of it and ends no campaign."""

import pytest

from service.study.estimation import unit as unit_module
from service.study.estimation.flight.drive import UndrivenError
from service.study.estimation.unit import Unit, run_unit


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (UndrivenError("calibration refused: no rows"), "calibration refused: no rows"),
        (ZeroDivisionError("by zero"), "the product failed: ZeroDivisionError: by zero"),
    ],
)
def test_a_world_that_cannot_be_driven_is_a_refusal(monkeypatch, toured_world, error, words):
    def drive(ground):
        raise error

    monkeypatch.setattr(unit_module, "export_world", lambda *_: None)
    monkeypatch.setattr(unit_module, "read_world", lambda _: toured_world)
    monkeypatch.setattr(unit_module, "drive", drive)
    result = run_unit(Unit("octants", 1))
    assert result.refusal == words
    assert (result.methods, result.course) == ({}, None)


def test_what_was_said_is_measured_and_kept_for_the_figures(monkeypatch, toured_world, said, driven_world):
    driven = driven_world({"robust": said(toured_world.truth.attitude_deg)})
    monkeypatch.setattr(unit_module, "export_world", lambda *_: None)
    monkeypatch.setattr(unit_module, "read_world", lambda _: toured_world)
    monkeypatch.setattr(unit_module, "drive", lambda _: driven)
    oracle = said(0.9 * toured_world.truth.attitude_deg)
    monkeypatch.setattr(unit_module, "oracle_series", lambda _world, _rows: oracle)
    result = run_unit(Unit("octants", 1))
    assert result.refusal == ""
    assert set(result.methods) == {"robust", "oracle"}
    assert set(result.yardsticks) == {"robust", "never allow", "always allow", "three sigma", "oracle"}
    assert set(result.baselines) == {"zero", "corrections", "coupling", "corrections_read"}
    assert result.course is not None
    assert result.course.hours[-1] == pytest.approx(2999 / 60, rel=1e-6)  # float32
    # the zero answer's error is the truth's own size, after the first hour
    assert result.baselines["zero"].answered == 1.0
