"""Worlds, calibrations and flights kept by the hash of the sources that make them.

A result lies below ``.cache/worlds`` under the hash of the sources, of the libraries and of its own arguments; any
change of one of them makes another hash, so that a result is never older than the code under test. Processes that want
the same result at once wait for the one that computes it. ``make clean`` removes all.
"""

import fcntl
import hashlib
import pickle
import shutil
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import ParamSpec, TypeVar

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / ".cache" / "worlds"
#: all that a world, its calibration and a flight through the chain are made of
SOURCES = ("analyzer_sim", "service/core", "service/pipeline", "service/records", "service/study", "tests/fakes/worlds")
LIBRARIES = ("numpy", "scipy", "numba")
#: sets of sources whose results stay: a change, its parent and what lies between them
KEPT_SETS = 4

P = ParamSpec("P")
R = TypeVar("R")


@cache
def sources_hash() -> str:
    """Return the hash of the sources and libraries."""
    digest = hashlib.sha256(" ".join([sys.version, *map(version, LIBRARIES)]).encode())
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:20]


@cache
def folder_of_sources() -> Path:
    """Return the folder of these sources; those of sources that were not used for longest are removed."""
    folder = FOLDER / sources_hash()
    folder.mkdir(parents=True, exist_ok=True)
    folder.touch()
    for old in sorted(FOLDER.iterdir(), key=used_at, reverse=True)[KEPT_SETS:]:
        shutil.rmtree(old, ignore_errors=True)
    return folder


def used_at(folder: Path) -> float:
    """Return when a folder was used last; 0 where another process removes it at this moment."""
    try:
        return folder.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def kept(make: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R:
    """Return what a function makes of arguments whose ``repr`` says all; computed once for these sources."""
    asked = f"{make.__module__}.{make.__qualname__} {arguments!r} {sorted(options.items())!r}"
    path = folder_of_sources() / hashlib.sha256(asked.encode()).hexdigest()[:20]
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if path.exists():
            return pickle.loads(path.read_bytes())  # noqa: S301 - our own, below the checkout
        made = make(*arguments, **options)
        unfinished = path.with_suffix(".new")
        unfinished.write_bytes(pickle.dumps(made, pickle.HIGHEST_PROTOCOL))
        unfinished.rename(path)
        return made
