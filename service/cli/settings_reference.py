"""Reference of settings: every setting by the name of its environment variable, its default, meaning and origin.

Meaning and origin stand with the field (``service.records.setting``); plain fields are matters of operation. A field
that states none cannot be rendered, so none stays undocumented.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import SecretStr

from service.composition.settings import Settings
from service.records.setting import CHOSEN, ORIGINS


class SettingEntry(NamedTuple):
    """One setting as it is documented."""

    #: environment variable
    name: str
    default: str
    meaning: str
    origin: str
    #: value in force, secrets hidden
    value: str


def setting_entries(settings: Settings) -> Iterator[SettingEntry]:
    """Yield every setting in the order of its declaration, with the value that some settings give it."""
    for name, field in Settings.model_fields.items():
        value = getattr(settings, name)
        if dataclasses.is_dataclass(value):
            yield from _stage_entries(name, field.default, value)
        else:
            meaning = field.description or ""
            yield SettingEntry(_variable(name), _shown(field.default), meaning, CHOSEN, _shown(value))


def settings_markdown() -> str:
    """Return the page of settings: defaults, whatever the environment says."""
    origins = "\n".join(f"* *{word}*: {meaning}" for word, meaning in ORIGINS.items())
    rows = "\n".join(
        f"| `{entry.name}` | {entry.default} | {entry.meaning} | {entry.origin} |"
        for entry in setting_entries(Settings.model_construct())
    )
    return f"{_HEAD}\n{origins}\n\n| variable | default | meaning | origin |\n|---|---|---|---|\n{rows}\n"


def settings_text(settings: Settings) -> str:
    """Return the values in force, one line a setting; what differs from its default is marked."""
    entries = list(setting_entries(settings))
    width = max(len(entry.name) for entry in entries)
    return "\n".join(
        f"{'*' if entry.value != entry.default else ' '} {entry.name:{width}} {entry.value}" for entry in entries
    )


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
    return "none" if value is None else str(value)


_HEAD = """# Settings

Made by `soo settings --markdown`; `tests/docs/test_settings.py` holds page and code together. Settings are read once,
from the environment, or from the folder that `SOO_SECRETS_DIR` names, which has a file for each, called as the variable
(`soo_bootstrap_key`). A double underscore leads into the configuration of a stage:
`SOO_INTERLOCK__VALIDITY_LIMIT_DEG=0.35`. `soo settings` prints the values in force and marks what was changed; the
database, address, port, clock and the files of TLS can be given to `soo serve` as options, which win.

The column *origin* says where a default comes from:
"""
