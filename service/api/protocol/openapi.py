"""The OpenAPI document, and the reference page made of it."""

import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service.api.problems.problems import PROBLEM_MEDIA_TYPE, ProblemSchema
from service.records.setting import unit_of

MEANINGS: Mapping[str, str] = json.loads(Path(__file__).with_name("field_meanings.json").read_text(encoding="utf-8"))


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
    return f"{text.rstrip('.')}; {unit}."


API_VERSION = "1.0"
_REF = "#/components/schemas/"
_BEARER = "HTTPBearer"
#: what stands below needs a key
_PROTECTED = "/api/"
_DESCRIPTION = (
    "Attitude of a geostationary satellite from the powers of the carriers it retransmits. "
    "Times are RFC 3339 UTC; intervals include their start and exclude their stop; absent values are null; "
    "every unit stands in the name of its field. Every error is a problem of RFC 9457."
)


def describe(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document of an application."""
    document = get_openapi(
        title="SOO",
        version=API_VERSION,
        summary="Attitude estimation service",
        description=_DESCRIPTION,
        routes=app.routes,
    )
    schemas: dict[str, Any] = document.setdefault("components", {}).setdefault("schemas", {})
    schemas.update(_definitions(ProblemSchema.model_json_schema(ref_template=_REF + "{model}"), "ProblemSchema"))
    for path, operations in document["paths"].items():
        for operation in operations.values():
            _lift_body(operation, schemas)
            _state_problems(operation, is_counted=path.startswith(_PROTECTED))
            if path.startswith(_PROTECTED):
                operation["security"] = [{_BEARER: []}]
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    document["components"]["securitySchemes"] = {
        _BEARER: {"type": "http", "scheme": "bearer", "description": "Key of this service"}
    }
    problem = {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": _REF + "ProblemSchema"}}}
    document["components"]["responses"] = {"Problem": {"description": "Problem", "content": problem}}
    describe_properties(schemas)
    document["components"]["schemas"] = dict(sorted(schemas.items()))
    return document


def as_text(document: dict[str, Any]) -> str:
    """Return the document as it is committed: sorted, indented, ending with a line feed."""
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _lift_body(operation: dict[str, Any], schemas: dict[str, Any]) -> None:
    """Move the schema of a raw body to the components."""
    content = operation.get("requestBody", {}).get("content", {}).get("application/json", {})
    schema = content.get("schema", {})
    if "title" not in schema:
        return
    name = f"{schema['title']}Input"
    definitions = schema.pop("$defs", {})
    schemas.update({f"{key}Input": value for key, value in definitions.items()})
    schemas[name] = schema
    content["schema"] = {"$ref": _REF + name}


def _definitions(schema: dict[str, Any], name: str) -> dict[str, Any]:
    return {**schema.pop("$defs", {}), name: schema}


def _state_problems(operation: dict[str, Any], *, is_counted: bool) -> None:
    """Document every refusal as a problem, and name those that any request may get."""
    responses = operation["responses"]
    responses.pop("422", None)
    named = (["413", "422"] if "requestBody" in operation else []) + (["429"] if is_counted else [])
    responses |= {status: {"$ref": "#/components/responses/Problem"} for status in (*named, "default")}


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #16202a; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h2 { margin-top: 2.2rem; border-bottom: 1px solid #c9d3dc }
details { border: 1px solid #d8e0e7; border-radius: 4px; margin: .4rem 0; padding: .35rem .7rem }
summary { cursor: pointer }
code { font: 13px ui-monospace, monospace }
.method { display: inline-block; min-width: 4.2rem; font-weight: 700; color: #0b5394 }
table { border-collapse: collapse; margin: .4rem 0 } td, th { text-align: left; padding: .15rem .8rem .15rem 0 }
"""


def render_page(document: dict[str, Any]) -> str:
    """Return the HTML page of an OpenAPI document, one section a tag, one entry an operation."""
    sections: dict[str, list[str]] = {}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            tag = (operation.get("tags") or ["other"])[0]
            sections.setdefault(tag, []).append(_operation(path, method, operation))
    body = "".join(f"<h2>{escape(tag)}</h2>{''.join(entries)}" for tag, entries in sections.items())
    schemas = "".join(
        _schema(name, schema) for name, schema in document.get("components", {}).get("schemas", {}).items()
    )
    info = document["info"]
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{escape(info['title'])} API</title>"
        f"<style>{_STYLE}</style></head><body><h1>{escape(info['title'])} API, version {escape(info['version'])}</h1>"
        f"<p>{escape(info.get('description', ''))}</p>"
        "<p>The same as a document for programs: <a href='/openapi.json'>openapi.json</a>.</p>"
        f"{body}<h2>shapes</h2>{schemas}</body></html>"
    )


def _operation(path: str, method: str, operation: dict[str, Any]) -> str:
    """Return one operation with its parameters, body and answers."""
    summary = escape(operation.get("summary", ""))
    parameters = "".join(
        f"<tr><td><code>{escape(item['name'])}</code></td><td>{item['in']}</td>"
        f"<td>{'required' if item.get('required') else 'optional'}</td>"
        f"<td>{_type(item.get('schema', {}))}</td><td>{escape(item.get('description', ''))}</td></tr>"
        for item in operation.get("parameters", [])
    )
    contents = operation.get("requestBody", {}).get("content", {})
    bodies = "".join(
        f"<p>Body, <code>{escape(media)}</code>: {_type(value.get('schema', {}))}</p>"
        for media, value in contents.items()
    )
    answers = "".join(
        f"<tr><td><code>{status}</code></td><td>{escape(answer.get('description', ''))}</td>"
        f"<td>{' '.join(_type(value.get('schema', {})) for value in answer.get('content', {}).values())}</td></tr>"
        for status, answer in operation.get("responses", {}).items()
    )
    return (
        f"<details><summary><span class='method'>{method.upper()}</span><code>{escape(path)}</code> {summary}</summary>"
        f"<p>{escape(operation.get('description', ''))}</p><table>{parameters}</table>{bodies}"
        f"<table>{answers}</table></details>"
    )


def _schema(name: str, schema: dict[str, Any]) -> str:
    required = set(schema.get("required", ()))
    fields = "".join(
        f"<tr><td><code>{escape(field)}</code></td><td>{'required' if field in required else ''}</td>"
        f"<td>{_type(value)}</td><td>{escape(value.get('description', ''))}</td></tr>"
        for field, value in schema.get("properties", {}).items()
    )
    words = " | ".join(escape(str(word)) for word in schema.get("enum", ()))
    return (
        f"<details id='{escape(name)}'><summary><code>{escape(name)}</code></summary>"
        f"<p>{escape(schema.get('description', ''))} {words}</p><table>{fields}</table></details>"
    )


def _type(schema: dict[str, Any]) -> str:
    """Return the type of a schema in words, with a link to a named shape."""
    if "$ref" in schema:
        name = escape(schema["$ref"].rsplit("/", 1)[-1])
        return f"<a href='#{name}'>{name}</a>"
    for union in ("anyOf", "oneOf", "allOf"):
        if union in schema:
            return " or ".join(_type(part) for part in schema[union])
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return escape(str(schema.get("type", "any")))
