"""Meanings of fields: descriptions of properties that state none of their own, by ``Schema.field`` or ``field``.

A record's ``Annotated`` goes before the table. The unit stands at the end of a field's name and is added from there.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.records.units import unit_of

MEANINGS: Mapping[str, str] = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))


def describe_properties(schemas: Mapping[str, dict[str, Any]]) -> None:
    """Give every property of the schemas its description, with the unit that its name ends with."""
    for name, schema in schemas.items():
        for field, content in schema.get("properties", {}).items():
            text = content.get("description") or _meaning(name, field)
            unit = unit_of(field)
            content["description"] = text if unit is None or states_unit(text, unit) else _with(text, unit)


def states_unit(text: str, unit: str) -> bool:
    """Return whether a description states a unit as a word.

    Examples
    --------
    >>> states_unit("Time of the sweep.", "s"), states_unit("Time of the sweep, s.", "s")
    (False, True)
    """
    return re.search(rf"(?<![\w/']){re.escape(unit)}(?![\w/])", text) is not None


def _meaning(schema: str, field: str) -> str:
    """Return the meaning of a field, that of its schema before that of its name; empty where there is none."""
    names = (f"{schema}.{field}", f"{schema.removesuffix('Input')}.{field}", field)
    return next((MEANINGS[name] for name in names if name in MEANINGS), "")


def _with(text: str, unit: str) -> str:
    """Return a description that ends with its unit."""
    return f"{text.rstrip('.')}; {unit}."
