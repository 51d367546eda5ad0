"""The client's types of answers are those of the OpenAPI document."""

import json
from pathlib import Path

from service.cli.client_types import TYPES, client_types
from service.client import documents

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = json.loads((ROOT / "docs" / "reference" / "openapi.json").read_text())


def test_the_types_are_those_of_the_document() -> None:
    path = ROOT / "service" / "client" / "documents.py"
    assert path.read_text() == client_types(DOCUMENT), "run make schema"


def test_every_type_has_the_fields_of_its_schema() -> None:
    for schema, name in TYPES.items():
        properties = DOCUMENT["components"]["schemas"][schema]["properties"]
        assert getattr(documents, name).__annotations__.keys() == properties.keys(), name
