"""``soo compare``: rows of two versions by epoch, their differences against the numbers that made them."""

import json
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation.comparison import compare as compare_module
from service.records.epoch import format_epoch

START_US = 1_800_000_000_000_000
SPANS = {1: (0, 100), 2: (10, 200)}


def row(minute, angles_deg, *, sigma_deg=0.02, inhibitions=()):
    """Return a row as the service answers it."""
    axes = ("yaw", "roll", "pitch")
    return {
        "epoch": format_epoch(START_US + 60_000_000 * minute),
        **{f"{axis}_deg": angle for axis, angle in zip(axes, angles_deg, strict=True)},
        "sigma_deg": dict.fromkeys(axes, sigma_deg),
        "protection_deg": dict.fromkeys(axes),
        "control_allowed": not inhibitions,
        "inhibitions": list(inhibitions),
    }


@pytest.fixture
def held(monkeypatch):
    """Rows by version that the service holds, and what it was asked."""
    rows, asked = {}, []

    def history(spacecraft, start, stop, *, method, version):
        asked.append((spacecraft, start, stop, method, version))
        return [each for each in rows[version] if start <= each["epoch"] < stop]

    def replay(_, number):
        start, stop = (format_epoch(START_US + 60_000_000 * minute) for minute in SPANS[number])
        return {"start": start, "stop": stop}

    @contextmanager
    def connected(*_):
        yield SimpleNamespace(attitude_history=history, replay=replay)

    monkeypatch.setattr(compare_module, "connected", connected)
    return SimpleNamespace(rows=rows, asked=asked)


def run(*options):
    return CliRunner().invoke(app, ["compare", "--spacecraft", "sa-1", *options])


def test_figures_are_those_of_the_rows_that_both_have(held, tmp_path):
    # two rows of one epoch; one row without angles; one row in each alone
    held.rows["live"] = [
        row(9, (0.0, 0.0, 0.0)),
        row(20, (0.1, 0.2, 0.3), sigma_deg=0.03),
        row(20, (1.0, 1.0, 1.0), sigma_deg=0.04, inhibitions=("late",)),
        row(30, (None, None, None), sigma_deg=None, inhibitions=("no_fix",)),
        row(40, (0.0, 0.0, 0.0)),
    ]
    held.rows["replay-2"] = [
        row(20, (0.4, 0.2, 0.3)),
        row(20, (0.6, 1.0, 1.0), inhibitions=("late", "settling")),
        row(30, (0.0, 0.0, 0.0)),
        row(50, (0.0, 0.0, 0.0)),
    ]
    figure = tmp_path / "difference.png"
    result = run("live", "replay-2", "--json", "--figure", str(figure))
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert {asked[1:3] for asked in held.asked} == {(document["start"], document["stop"])}
    assert document["start"] == format_epoch(START_US + 600_000_000), "the span of the replay"
    assert document["rows"] == {"both": 3, "first_alone": 1, "second_alone": 1, "both_with_angles": 2}
    yaw = document["difference_deg"]["yaw"]
    np.testing.assert_allclose((yaw["rms"], yaw["greatest"]), (np.sqrt((0.3**2 + 0.4**2) / 2), -0.4), rtol=1e-9)
    assert yaw["greatest_at"] == format_epoch(START_US + 1_200_000_000)
    assert document["difference_deg"]["roll"]["rms"] == 0.0
    np.testing.assert_allclose(document["rms_sigma_deg"]["pitch"], [np.sqrt((0.03**2 + 0.04**2) / 2), 0.02])
    assert document["median_protection_deg"]["yaw"] == [None, None]
    np.testing.assert_allclose(document["control_allowed"], [1 / 3, 2 / 3])
    assert document["inhibitions"] == {"late": [1, 1], "no_fix": [1, 0], "settling": [0, 1]}
    assert figure.read_bytes().startswith(b"\x89PNG")
    lines = run("live", "replay-2").stdout
    assert "yaw    rms 0.3536, greatest -0.4000 deg at" in lines
    assert "settling: 0 -> 1 rows" in lines


def test_two_replays_are_compared_where_both_reach(held):
    held.rows |= {"replay-1": [row(50, (0.0, 0.0, 0.0))], "replay-2": [row(50, (0.0, 0.0, 0.0))]}
    assert run("replay-1", "replay-2", "--method", "paper").exit_code == 0
    span = tuple(format_epoch(START_US + 60_000_000 * minute) for minute in (10, 100))
    assert [asked[1:4] for asked in held.asked] == [(*span, "paper")] * 2


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("live", "live"), 2, "name two versions"),
        (("live", "replay"), 2, "no version"),
        (("live", "replay-x"), 2, "no version"),
        (("live", "3"), 2, "no version"),
        (("live", "replay-2"), 1, "no row in both, live has 0 and replay-2 has 1"),
        (("live", "replay-2", "--figure", "nowhere/x.png", "--start", "2000-01-01T00:00:00Z"), 1, "no row in both"),
    ],
)
def test_what_cannot_be_compared_ends_with_words(held, options, code, said):
    held.rows |= {"live": [], "replay-2": [row(20, (0.0, 0.0, 0.0))]}
    result = run(*options)
    assert result.exit_code == code
    assert said in result.stderr


def test_a_figure_that_cannot_be_written_is_said(held, tmp_path):
    held.rows |= {version: [row(20, (0.0, 0.0, 0.0))] for version in ("live", "replay-2")}
    result = run("live", "replay-2", "--figure", str(tmp_path / "nowhere" / "x.png"))
    assert (result.exit_code, "the figure cannot be written" in result.stderr) == (2, True)
