"""Types of the service's answers for the Python client, made of the OpenAPI document.

``make schema`` writes the document, then ``python -m docs.client_types`` the types.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import Any

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


def main() -> None:
    """Write the types of the stored document."""
    root = Path(__file__).resolve().parent
    document = json.loads((root / "reference" / "openapi.json").read_text(encoding="utf-8"))
    (root.parent / "service" / "client" / "documents.py").write_text(client_types(document), encoding="utf-8")


if __name__ == "__main__":
    main()
