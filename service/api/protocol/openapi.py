"""The OpenAPI document: what FastAPI knows, the bodies that are read raw, and the one problem shape."""

import json
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service.api.problems.problems import PROBLEM_MEDIA_TYPE, ProblemSchema
from service.api.protocol.field_meanings import describe_properties

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
    """Return a schema and what it refers to, by name."""
    return {**schema.pop("$defs", {}), name: schema}


def _state_problems(operation: dict[str, Any], *, is_counted: bool) -> None:
    """Document every refusal as a problem, and name those that any request may get."""
    responses = operation["responses"]
    responses.pop("422", None)
    named = (["413", "422"] if "requestBody" in operation else []) + (["429"] if is_counted else [])
    responses |= {status: {"$ref": "#/components/responses/Problem"} for status in (*named, "default")}
