"""Extras of the installation: third-party packages that only some commands need."""

from importlib import import_module

#: extra by the name under which a package is imported
EXTRA_OF = {"matplotlib": "study", "pyvisa": "station", "pyvisa_py": "station"}


def require(name: str) -> None:
    """Import a package of an extra, so that a command ends at once where it is missing.

    Raises
    ------
    ModuleNotFoundError
        It is not installed; ``service.__main__`` says which extra has it.
    """
    import_module(name)
