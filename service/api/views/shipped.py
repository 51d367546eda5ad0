"""The program and the distributions that are installed with it, with their licences."""

import re
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from typing import NamedTuple

PROGRAM = "soo"
#: distributions looked at, and letters of a licence: metadata are written by others
_MOST_DISTRIBUTIONS, _MOST_LETTERS = 300, 200
#: extras that the product or a part of it is installed with; others are tools that may stand beside it
_EXTRAS = {"", "console", "binary"}
_EXTRA = re.compile(r"""extra\s*==\s*['"]([\w-]+)""")


class ShippedDistribution(NamedTuple):
    """Installed distribution."""

    name: str
    version: str
    #: as its metadata state it; None where they do not
    licence: str | None


@cache
def shipped_distributions() -> tuple[ShippedDistribution, ...]:
    """Return the program, then what it needs and what that needs, as far as it is installed, by name."""
    found: dict[str, ShippedDistribution] = {}
    waiting = [PROGRAM]
    while waiting and len(found) < _MOST_DISTRIBUTIONS:
        name = _normal(waiting.pop())
        if name in found:
            continue
        try:
            held = distribution(name)
        except PackageNotFoundError:
            # of another platform, or an extra that nobody asked for
            continue
        found[name] = ShippedDistribution(held.metadata["Name"], held.version, _licence(held))
        waiting += [re.split(r"[^\w.-]", each)[0] for each in held.requires or () if _extra(each) in _EXTRAS]
    return tuple(found[name] for name in sorted(found, key=lambda each: (each != PROGRAM, each)))


def program_version() -> str:
    """Return the version of the program, `unknown` where it runs without being installed."""
    return next((each.version for each in shipped_distributions() if each.name == PROGRAM), "unknown")


def _licence(held: Distribution) -> str | None:
    """Return the licence: the expression, else the classifiers, else the first line of the text."""
    expressions, texts, classifiers = (
        held.metadata.get_all(name) or [""] for name in ("License-Expression", "License", "Classifier")
    )
    approved = ", ".join(each.split(" :: ")[-1] for each in classifiers if each.startswith("License :: "))
    return (expressions[0] or approved or texts[0].strip().partition("\n")[0])[:_MOST_LETTERS] or None


def _extra(requirement: str) -> str:
    """Return the extra that a requirement belongs to, empty where it always holds."""
    found = _EXTRA.search(requirement)
    return found[1] if found else ""


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
