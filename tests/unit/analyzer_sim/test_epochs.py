"""Epochs as text and back."""

import pytest

from analyzer_sim.epochs import epoch_us_from_text, rfc3339


def test_text_has_six_decimals_and_z() -> None:
    assert rfc3339(1_793_491_200_000_007) == "2026-11-01T00:00:00.000007Z"


@pytest.mark.parametrize("epoch_us", [0, 1, 951_782_400_123_456, 1_793_491_200_000_000])
def test_round_trip_is_exact(epoch_us: int) -> None:
    assert epoch_us_from_text(rfc3339(epoch_us)) == epoch_us


def test_a_text_without_zone_is_refused() -> None:
    with pytest.raises(ValueError, match="time zone"):
        epoch_us_from_text("2026-11-01T00:00:00")
