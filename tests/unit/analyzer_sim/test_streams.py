"""Named streams: the seed and the name decide, nothing else."""

from analyzer_sim.streams import stream


def test_same_seed_and_name_give_the_same_numbers() -> None:
    assert stream(3, "white", "c00").normal(size=5).tolist() == stream(3, "white", "c00").normal(size=5).tolist()


def test_another_seed_or_name_gives_other_numbers() -> None:
    base = stream(3, "white", "c00").normal()
    assert base not in {stream(4, "white", "c00").normal(), stream(3, "white", "c01").normal(), stream(3).normal()}


def test_a_longer_series_begins_with_the_shorter_one() -> None:
    assert stream(3, "a").normal(size=4).tolist() == stream(3, "a").normal(size=9)[:4].tolist()
