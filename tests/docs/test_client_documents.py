"""The client's types of answers have the fields of the OpenAPI document, no more and no fewer."""

import json
from pathlib import Path
from typing import get_type_hints

import pytest

from service.client import documents

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = json.loads((ROOT / "docs" / "reference" / "openapi.json").read_text())["components"]["schemas"]
TYPES = {
    documents.Receipt: "MeasurementReceiptAnswer",
    documents.Measurement: "MeasurementAnswer",
    documents.Attitude: "NewestAttitudeAnswer",
    documents.ControlReason: "ControlReasonAnswer",
    documents.Verdict: "VerdictAnswer",
    documents.Angles: "AnglesAnswer",
    documents.AllowedAxes: "AllowedAxesAnswer",
    documents.Exclusion: "ExclusionAnswer",
    documents.Status: "StatusAnswer",
    documents.Pulse: "PulseAnswer",
    documents.Check: "CheckAnswer",
    documents.Command: "CommandAnswer",
    documents.Control: "ControlAnswer",
}


@pytest.mark.parametrize(("kind", "schema"), TYPES.items(), ids=lambda value: getattr(value, "__name__", value))
def test_fields_are_those_of_the_interface(kind: type, schema: str) -> None:
    properties = SCHEMAS[schema]["properties"]
    hints = get_type_hints(kind)
    assert hints.keys() == properties.keys()
    for name, hint in hints.items():
        is_nullable = {"type": "null"} in properties[name].get("anyOf", [])
        assert (type(None) in getattr(hint, "__args__", ())) == is_nullable, name
