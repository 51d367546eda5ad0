"""Settings in force by the names of their variables, secrets hidden.

Meaning and origin stand with the field (``service.records.setting``); plain fields are matters of operation. A field
that states none cannot be shown, so none stays undocumented.
"""

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import SecretStr

from service.composition.settings import Settings
from service.records.setting import CHOSEN, SettingEntry, SettingSource


def setting_entries(settings: Settings) -> Iterator[SettingEntry]:
    """Yield every setting in the order of its declaration, with the value that some settings give it."""
    for name, field in Settings.model_fields.items():
        value = getattr(settings, name)
        if dataclasses.is_dataclass(value):
            yield from _stage_entries(name, field.default, value)
        else:
            meaning = field.description or ""
            yield SettingEntry(_variable(name), _shown(field.default), meaning, CHOSEN, _shown(value))


def entries_in_force(settings: Settings) -> tuple[SettingEntry, ...]:
    """Return every setting with where its value was read; one that neither variable nor file gives is an option's."""
    read = {entry.name: entry.value for entry in setting_entries(Settings.model_validate({}))}
    return tuple(
        entry._replace(source=_source(entry.name) if entry.value == read[entry.name] else "option")
        for entry in setting_entries(settings)
    )


def _source(name: str) -> SettingSource:
    """Return where a setting is read when no option gives it."""
    # a whole stage may stand in one variable, as JSON
    names = {name, name.partition("__")[0]}
    if any(value and variable.upper() in names for variable, value in os.environ.items()):
        return "environment"
    folder = os.environ.get("SOO_SECRETS_DIR")
    files = {path.name.upper() for path in Path(folder).iterdir()} if folder else set()
    return "file" if names & files else "default"


def _stage_entries(path: str, default: Any, value: Any) -> Iterator[SettingEntry]:
    """Yield the settings of a stage's configuration at every depth."""
    for field in dataclasses.fields(value):
        inner = f"{path}.{field.name}"
        inner_default, inner_value = getattr(default, field.name), getattr(value, field.name)
        if dataclasses.is_dataclass(inner_value):
            yield from _stage_entries(inner, inner_default, inner_value)
        else:
            said = field.metadata
            shown = _shown(inner_default), said["meaning"], said["origin"], _shown(inner_value)
            yield SettingEntry(_variable(inner), *shown)


def _variable(path: str) -> str:
    """Return the environment variable of a setting."""
    return "SOO_" + path.replace(".", "__").upper()


def _shown(value: object) -> str:
    """Return a value as it is printed; a secret only says that it is set."""
    if isinstance(value, SecretStr):
        return "(set)"
    return "none" if value is None else _without_password(str(value))


def _without_password(text: str) -> str:
    """Return a text as it is, a URL without user, password and parameters, any of which may hold a secret."""
    scheme, mark, rest = text.partition("://")
    # a password may hold any sign: only what follows the last @ is shown
    _, at, shown = rest.rpartition("@")
    shown, has_parameters, _ = shown.partition("?")
    return f"{scheme}{mark}{'***@' if at else ''}{shown}{'?***' if has_parameters else ''}" if mark else text
