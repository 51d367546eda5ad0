"""Nodes, period and track from what an orbit was stated by."""

import numpy as np
import pytest

from service.errors import InvalidInputError
from service.formats.ephemeris.orbit import ephemeris_from_nodes, ephemeris_from_positions, find_nodes
from service.records.catalogue import Track

DAY_US = 86_400_000_000
T0_US = 1_795_230_000_000_000
STEP_US = 600_000_000


def circular(period_s: float, inclination_deg: float, node_us: float, days: int, longitude_deg: float = 90.0):
    """Positions of an inclined circular orbit over a fixed longitude; the node is exact by construction."""
    epochs_us = T0_US + np.arange(0, days * DAY_US, STEP_US, dtype=np.int64)
    phase = 2 * np.pi * (epochs_us - node_us) / (period_s * 1e6)
    latitude = np.radians(inclination_deg) * np.sin(phase)
    longitude = np.radians(longitude_deg)
    xyz = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    return epochs_us, 42_164.0 * xyz


@pytest.mark.parametrize("offset_s", [601.0, 12_345.678, 40_000.0, 86_000.0])
def test_nodes_between_samples_are_found_within_two_milliseconds(offset_s):
    period_s = 86_164.0905
    node_us = T0_US + offset_s * 1e6
    epochs_us, xyz_km = circular(period_s, 5.9, node_us, 4)
    nodes_us = find_nodes(epochs_us, xyz_km[2])
    expected_us = node_us + np.arange(len(nodes_us)) * period_s * 1e6
    # the cubic through four samples of a sine 2.5 deg apart errs by 1e-7 of its amplitude, 1.2 ms
    np.testing.assert_allclose(nodes_us, expected_us, atol=2000)
    assert len(nodes_us) >= 3


def test_positions_give_period_track_and_validity():
    epochs_us, xyz_km = circular(86_164.0, 2.0, T0_US + 5e9, 5, longitude_deg=179.99)
    ephemeris = ephemeris_from_positions("oem", epochs_us, xyz_km)
    # two nodes of 1.2 ms over four days
    assert ephemeris.nodal_period_s == pytest.approx(86_164.0, abs=1e-3)
    assert (ephemeris.valid_start_us, ephemeris.valid_stop_us) == (epochs_us[0], epochs_us[-1])
    assert ephemeris.form == "oem"
    # rounded to 1e-7 deg
    np.testing.assert_allclose(ephemeris.track.longitude_deg, 179.99, atol=1e-7)
    assert max(ephemeris.track.latitude_deg) == pytest.approx(2.0, abs=1e-3), "samples 2.5 deg of phase apart"


def test_a_track_across_the_date_line_does_not_jump():
    epochs_us, xyz_km = circular(86_164.0, 2.0, T0_US + 5e9, 3, longitude_deg=0.0)
    swing = np.radians(180.0 + 0.05 * np.sin(np.arange(len(epochs_us)) / 20))
    r = np.hypot(xyz_km[0], xyz_km[1])
    track = ephemeris_from_positions(
        "oem", epochs_us, np.array([r * np.cos(swing), r * np.sin(swing), xyz_km[2]])
    ).track
    assert np.max(np.abs(np.diff(track.longitude_deg))) < 0.01


@pytest.mark.parametrize(
    ("scale", "inclination_deg", "days", "code"),
    [
        (0.2, 5.0, 4, "ephemeris.not_geosynchronous"),
        (1.2, 5.0, 4, "ephemeris.not_geosynchronous"),
        (1.0, 0.001, 4, "ephemeris.no_nodes"),
        (1.0, 5.0, 1, "ephemeris.no_nodes"),
    ],
)
def test_orbits_without_nodes_of_use_are_refused(scale, inclination_deg, days, code):
    epochs_us, xyz_km = circular(86_164.0, inclination_deg, T0_US + 5e9, days)
    with pytest.raises(InvalidInputError) as caught:
        ephemeris_from_positions("oem", epochs_us, xyz_km * scale)
    assert caught.value.code == code


def test_nodes_with_gaps_give_the_period_of_one_revolution():
    period_us = 86_328_000_000
    nodes_us = [T0_US + k * period_us for k in (0, 1, 4, 6)]
    ephemeris = ephemeris_from_nodes(nodes_us, None)
    assert ephemeris.nodal_period_s == 86_328.0
    assert (ephemeris.valid_start_us, ephemeris.valid_stop_us) == (nodes_us[0] - period_us, nodes_us[-1] + period_us)


@pytest.mark.parametrize(
    ("nodes_us", "period_s", "code"),
    [
        ([], 86_164.0, "ephemeris.nodes"),
        ([T0_US], None, "ephemeris.period_missing"),
        ([T0_US], 79_999.0, "ephemeris.period"),
        ([T0_US], float("nan"), "ephemeris.period"),
        ([T0_US, T0_US + DAY_US // 2], None, "ephemeris.period"),
        ([T0_US, T0_US + DAY_US // 3], 86_164.0, "ephemeris.nodes"),
        ([T0_US + 1, T0_US], 86_164.0, "ephemeris.nodes"),
    ],
)
def test_node_lists_that_cannot_be_are_refused(nodes_us, period_s, code):
    with pytest.raises(InvalidInputError) as caught:
        ephemeris_from_nodes(nodes_us, period_s)
    assert caught.value.code == code


@pytest.mark.parametrize(
    "track", [Track((1, 2), (0.0,), (0.0, 0.0)), Track((1,), (0.0,), (0.0,)), Track((2, 1), (0.0, 0.0), (0.0, 0.0))]
)
def test_tracks_whose_columns_do_not_belong_together_are_refused(track):
    with pytest.raises(InvalidInputError) as caught:
        ephemeris_from_nodes([T0_US], 86_164.0, track)
    assert caught.value.code == "ephemeris.track"
