"""Distributions of the product: what it needs and what that needs, as far as it is installed, whatever they state."""

from email.message import Message
from importlib.metadata import PackageNotFoundError

import pytest

from service.api.views import shipped


class Held:
    """Installed distribution with some metadata."""

    version = "1.2"

    def __init__(self, name, requires=None, **stated):
        self.requires = requires
        self.metadata = Message()
        self.metadata["Name"] = name
        for key, values in stated.items():
            for value in values:
                self.metadata[key.replace("_", "-")] = value


WORLD = {
    "soo": Held(
        "soo",
        ["Some_Lib[binary]>=2; python_version >= '3.9'", "youplot==1.0.0; extra == 'console'", "tool; extra=='study'"],
        License_Expression=["Apache-2.0"],
    ),
    "some-lib": Held("Some.Lib", ["soo", "absent>1"], License=["A licence\nwith its text " + "x" * 5000]),
    "youplot": Held("youplot", Classifier=["License :: OSI Approved :: MIT License", "Framework :: None"]),
    "tool": Held("tool", License=["never shipped"]),
}


@pytest.fixture
def world(monkeypatch):
    """A few distributions in place of those that are installed."""
    held = dict(WORLD)

    def found(name):
        if name not in held:
            raise PackageNotFoundError(name)
        return held[name]

    shipped.shipped_distributions.cache_clear()
    monkeypatch.setattr(shipped, "distribution", found)
    yield held
    shipped.shipped_distributions.cache_clear()


def test_what_is_needed_is_followed_round_circles(world):
    assert shipped.shipped_distributions() == (
        ("soo", "1.2", "Apache-2.0"),
        ("Some.Lib", "1.2", "A licence"),
        ("youplot", "1.2", "MIT License"),
    )
    assert shipped.program_version() == "1.2"


def test_a_program_that_is_not_installed(world):
    del world["soo"]
    assert shipped.shipped_distributions() == ()
    assert shipped.program_version() == "unknown"


def test_what_others_write_is_bounded(world):
    world["soo"] = Held("soo", [f"part{k}" for k in range(1000)], License_Expression=["x" * 1000])
    for k in range(1000):
        world[f"part{k}"] = Held(f"part{k}")
    found = shipped.shipped_distributions()
    assert len(found) == 300
    assert len(found[0].licence) == 200
    assert found[1].licence is None
