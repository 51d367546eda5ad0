"""Extras of the installation: third-party packages that only some commands need."""

from importlib import import_module
from typing import Annotated

import typer

#: extra by the name under which a package is imported
EXTRA_OF = {"matplotlib": "study", "pyvisa": "station", "pyvisa_py": "station", "distributed": "cluster"}


def require(name: str) -> None:
    """Import a package of an extra, so that a command ends at once where it is missing.

    Raises
    ------
    ModuleNotFoundError
        It is not installed; ``service.__main__`` says which extra has it.
    """
    import_module(name)


def _reachable(scheduler: str | None) -> str | None:
    """Return the address of a scheduler, or end before the work where the extra is missing."""
    if scheduler is not None:
        require("distributed")
    return scheduler


Scheduler = Annotated[
    str | None,
    typer.Option(help="Compute on the Dask cluster of this scheduler, as tcp://host:8786.", callback=_reachable),
]
