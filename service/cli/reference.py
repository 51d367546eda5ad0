"""``soo openapi`` and ``soo settings``: references that the code itself writes."""

import json
from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import Annotated, Any

import typer

from service.composition.settings import Settings, setting_entries
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


_TYPES_HEAD = '''"""Answers of the service as types, by ``make schema``; a newer service may add fields."""

from typing import Any, Literal, TypedDict

Json = dict[str, Any]
'''
#: schemas that have a type; any other object is `Json`
TYPES = {
    "AnglesAnswer": "Angles",
    "AllowedAxesAnswer": "AllowedAxes",
    "RowRemarkAnswer": "Refused",
    "MeasurementReceiptAnswer": "Receipt",
    "CatalogueWarning": "CatalogueWarningReply",
    "PlanReceiptAnswer": "PlanPut",
    "MeasurementAnswer": "MeasurementReply",
    "ExclusionAnswer": "ExclusionReply",
    "ControlReasonAnswer": "ControlReasonReply",
    "AxisMotionAnswer": "AxisMotionReply",
    "SpacecraftSituationAnswer": "SituationReply",
    "VerdictAnswer": "Verdict",
    "NewestAttitudeAnswer": "Attitude",
    "JobAnswer": "JobReply",
    "StatusAnswer": "StatusReply",
    "PulseAnswer": "PulseReply",
    "CheckAnswer": "Check",
    "CommandAnswer": "CommandReply",
    "ControlAnswer": "Control",
}
_PLAIN = {"string": "str", "number": "float", "integer": "int", "boolean": "bool", "null": "None"}
_LINE = 120


def client_types(document: Mapping[str, Any]) -> str:
    """Return the module with the types of the schemas in `TYPES`, formatted as ruff formats it."""
    schemas = document["components"]["schemas"]
    return _TYPES_HEAD + "".join(_class(name, schemas[schema], schemas) for schema, name in TYPES.items())


def _class(name: str, schema: Mapping[str, Any], schemas: Mapping[str, Any]) -> str:
    """Return one class."""
    lines = ["", "", f"class {name}(TypedDict):", f'    """{schema["description"].splitlines()[0]}"""', ""]
    properties = schema["properties"]
    for field in dict.fromkeys((*schema["required"], *properties)):
        content = properties[field]
        lines += (f"    #: {line}" for line in wrap(content.get("description", ""), _LINE - len("    #: ")))
        lines += _broken(f"    {field}: {_type(content, schemas)}")
    return "\n".join(lines) + "\n"


def _broken(line: str) -> list[str]:
    """Return a member on one line, else what is in brackets on one of its own, else each of these on its own."""
    if len(line) <= _LINE:
        return [line]
    head, _, inner = line.removesuffix("]").partition("[")
    inside = f"        {inner}"
    each = [inside] if len(inside) <= _LINE else [f"        {one}," for one in inner.split(", ")]
    return [f"{head}[", *each, "    ]"]


def _type(schema: Mapping[str, Any], schemas: Mapping[str, Any]) -> str:
    """Return the annotation of a schema."""
    if "$ref" in schema:
        referenced = schema["$ref"].rpartition("/")[2]
        is_object = schemas[referenced].get("type") == "object"
        return TYPES.get(referenced, "Json") if is_object else _type(schemas[referenced], schemas)
    if "anyOf" in schema:
        return " | ".join(_type(each, schemas) for each in schema["anyOf"])
    if "enum" in schema:
        values = ", ".join(f'"{value}"' for value in schema["enum"])
        return f"Literal[{values}]"
    if schema.get("type") == "array":
        return f"list[{_type(schema['items'], schemas)}]"
    if schema.get("type") == "object":
        member = schema.get("additionalProperties")
        return f"dict[str, {_type(member, schemas)}]" if isinstance(member, Mapping) else "Json"
    return _PLAIN[schema["type"]]


Output = Annotated[Path | None, typer.Option(help="File to write; without it the document is printed.")]


def openapi(
    types: Annotated[bool, typer.Option("--types", help="Types of the Python client instead of the document.")] = False,
    output: Output = None,
) -> None:
    """Write the OpenAPI document of this version."""
    # the web framework costs a quarter of a second that other commands need not pay
    from service.api.app import render_openapi

    document = render_openapi()
    if types:
        document = client_types(json.loads(document))
    _deliver(document, output)


def settings(
    markdown: Annotated[bool, typer.Option("--markdown", help="The reference page instead of values.")] = False,
    output: Output = None,
) -> None:
    """Print the settings in force, or the reference of all settings."""
    from service.composition.settings import Settings

    _deliver(settings_markdown() if markdown else settings_text(Settings.model_validate({})) + "\n", output)


def _deliver(text: str, output: Path | None) -> None:
    """Write a document to a file, or print it."""
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")
