"""Every property of the OpenAPI document says what it is, with its unit; no entry of the table is idle."""

import json

import pytest

from service.api.app import render_openapi
from service.api.protocol.field_meanings import MEANINGS, describe_properties, states_unit
from service.records.units import unit_of

SCHEMAS = json.loads(render_openapi())["components"]["schemas"]
PROPERTIES = [
    (name, field, content)
    for name, schema in SCHEMAS.items()
    for field, content in schema.get("properties", {}).items()
]


def test_every_property_has_a_description() -> None:
    assert len(PROPERTIES) > 1400
    # a unit alone is no description
    said = {f"{name}.{field}": content["description"].partition("; ")[0] for name, field, content in PROPERTIES}
    assert [name for name, text in said.items() if len(text) < 3] == []


def test_a_unit_that_the_name_ends_with_is_said() -> None:
    silent = [
        f"{name}.{field}"
        for name, field, content in PROPERTIES
        if (unit := unit_of(field)) is not None and not states_unit(content["description"], unit)
    ]
    assert silent == []


@pytest.mark.parametrize("axis", ["yaw", "roll", "pitch"])
def test_an_angle_says_its_sign(axis: str) -> None:
    angles = [content["description"] for _, field, content in PROPERTIES if field == f"{axis}_deg"]
    assert len(angles) > 10
    assert all("positive" in text for text in angles), angles


def test_every_meaning_is_used() -> None:
    of_schemas = {f"{name.removesuffix('Input')}.{field}" for name, field, _ in PROPERTIES}
    of_schemas |= {f"{name}.{field}" for name, field, _ in PROPERTIES}
    fields = {field for _, field, _ in PROPERTIES}
    assert [name for name in MEANINGS if name not in (of_schemas if "." in name else fields)] == []


def test_a_description_of_the_record_goes_before_the_table() -> None:
    schemas = {"One": {"properties": {"yaw_deg": {"description": "Mean angle."}, "roll_deg": {}, "odd": {}}}}
    describe_properties(schemas)
    described = {name: content["description"] for name, content in schemas["One"]["properties"].items()}
    assert described == {"yaw_deg": "Mean angle; deg.", "roll_deg": MEANINGS["roll_deg"][:-1] + "; deg.", "odd": ""}
