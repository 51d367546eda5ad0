"""``soo beams``: text, JSON and a figure of an answer of the service."""

import json
from contextlib import contextmanager

import numpy as np
import pytest
from typer.testing import CliRunner

from service.cli.command_group import new_app
from service.cli.planning import beams as beams_module

HOURS = 48


def answer(cause="antenna_or_sensor", change=4.2, is_told=True):
    """Return an answer as the interface gives it."""
    rng = np.random.default_rng(2)
    wave = {"amplitude_deg": 0.0312, "sigma_deg": 0.005, "peak_h": 15.9}
    none = {"amplitude_deg": None, "sigma_deg": None, "peak_h": None}
    axis = {
        "mean_deg": 0.0021 if is_told else None,
        "mean_sigma_deg": 0.001,
        "constant_sigma_deg": 0.0023,
        "drift_deg_per_day": 0.0,
        "drift_sigma_deg_per_day": 0.001,
        "daily": wave if is_told else none,
        "yearly": none,
        "residual_rms_deg": 0.01,
    }
    column = [None if k == 3 else round(0.03 * float(np.cos(k / 4)), 4) for k in range(HOURS)]
    stations = [
        {
            "carrier": f"c{k:02d}",
            "transponder": f"Ku{k % 2}",
            "azimuth_deg": float(rng.uniform(-3, 3)),
            "elevation_deg": float(rng.uniform(4, 7)),
            "gradient_db_per_deg": {"east": float(rng.normal()), "north": float(rng.normal())},
            "gradient_sigma_db_per_deg": {"east": 0.06, "north": 0.07},
            "curvature_db_per_deg2": {"east_east": -2.0, "east_north": None, "north_north": -2.1},
            "curvature_sigma_db_per_deg2": {"east_east": 0.5, "east_north": None, "north_north": 0.5},
            "change_sigmas": change if k == 1 else 0.4,
        }
        for k in range(8)
    ]
    return {
        "calibration_id": 4,
        "compared_calibration_id": 2,
        "sensors": ["star_tracker"],
        "epochs": [f"2026-11-{20 + k // 24}T{k % 24:02d}:00:00.000000Z" for k in range(HOURS)],
        "turned": [k == 3 for k in range(HOURS)],
        "antennas": [
            {
                "antenna": "Ku",
                "carriers": [one["carrier"] for one in stations],
                "cause": cause,
                "east": axis,
                "north": axis,
                **{f"{name}_deg": column for name in ("east", "north")},
                **{f"{name}_sigma_deg": [0.01] * HOURS for name in ("east", "north")},
            }
        ],
        "stations": stations,
        "notes": ["with one antenna a boresight cannot be told from an error of the sensor"],
    }


@pytest.fixture
def run(monkeypatch):
    """Run the command against a service that gives an answer."""
    asked = []

    def of(document, *arguments):
        class Client:
            def beams(self, *args, **options):
                asked.append((args, options))
                return document

        @contextmanager
        def connected(*_):
            yield Client()

        monkeypatch.setattr(beams_module, "connected", connected)
        app = new_app()
        app.command()(beams_module.beams)
        return CliRunner().invoke(app, ["--spacecraft", "sc", *arguments]), asked

    return of


def test_text_says_where_each_antenna_points_and_what_that_proves(run):
    result, asked = run(answer(), "--start", "2026-11-20T00:00:00Z", "--group", "transponder")
    assert result.exit_code == 0, result.output
    assert asked == [(("sc", "2026-11-20T00:00:00Z", None), {"group": "transponder"})]
    assert "48 hours, 1 of them left out because the body turned" in result.output
    assert "there is no other antenna to compare with" in result.output
    assert "each day +-0.0312 (sigma 0.0050), greatest at 15:54 UTC" in result.output
    assert "beams changed since calibration 2: c01 (4.2 sigma)" in result.output
    assert "note: with one antenna" in result.output


def test_what_is_not_told_is_said(run):
    result, _ = run(answer("none", change=None, is_told=False))
    assert result.output.count("not told") == 2
    assert "no daily change was found" in result.output
    assert "beams changed since calibration 2: none" in result.output


def test_figure_and_json(run, tmp_path):
    path = tmp_path / "beams.png"
    document = answer()
    result, _ = run(document, "--figure", str(path), "--json")
    assert json.loads(result.output) == document
    assert path.read_bytes().startswith(b"\x89PNG")
    refused, _ = run(document, "--figure", str(tmp_path / "none" / "beams.png"))
    assert refused.exit_code != 0
    assert "the figure cannot be written" in refused.output
    empty = document | {"antennas": [], "stations": [], "epochs": [], "turned": []}
    assert run(empty, "--figure", str(path))[0].exit_code == 0
