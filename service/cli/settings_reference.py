"""Reference of settings: every setting by the name of its environment variable, its default, meaning and origin."""

from service.composition.setting_entries import setting_entries
from service.composition.settings import Settings
from service.records.setting import ORIGINS


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


_HEAD = """# Settings

Made by `soo settings --markdown`; `tests/docs/test_reference.py` holds page and code together. Settings are read once,
from the environment, or from the folder that `SOO_SECRETS_DIR` names, which has a file for each, called as the variable
(`soo_bootstrap_key`). A double underscore leads into the configuration of a stage:
`SOO_INTERLOCK__VALIDITY_LIMIT_DEG=0.35`. `soo settings` prints the values in force and marks what was changed; the
database, address, port, clock and the files of TLS can be given to `soo serve` as options, which win.

The column *origin* says where a default comes from:
"""
