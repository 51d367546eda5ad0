"""Documents of the interface: meanings of fields, the reference page, and the licences of what is shipped."""

import json
from email.message import Message
from importlib.metadata import PackageNotFoundError
from typing import Any

import pytest

from service.api.app import render_openapi
from service.api.protocol.openapi import MEANINGS, describe_properties, render_page, states_unit
from service.api.views import shipped
from service.records.setting import unit_of

#: schema, name and content of each
Properties = list[tuple[str, str, dict[str, Any]]]


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """Return the OpenAPI document."""
    return json.loads(render_openapi())


@pytest.fixture(scope="module")
def properties(document: dict[str, Any]) -> Properties:
    """Return every property."""
    schemas = document["components"]["schemas"].items()
    return [(name, *each) for name, schema in schemas for each in schema.get("properties", {}).items()]


def test_every_property_has_a_description(properties: Properties) -> None:
    assert len(properties) > 1400
    # a unit alone is no description
    said = {f"{name}.{field}": content["description"].partition("; ")[0] for name, field, content in properties}
    assert [name for name, text in said.items() if len(text) < 3] == []


def test_a_unit_that_the_name_ends_with_is_said(properties: Properties) -> None:
    silent = [
        f"{name}.{field}"
        for name, field, content in properties
        if (unit := unit_of(field)) is not None and not states_unit(content["description"], unit)
    ]
    assert silent == []


@pytest.mark.parametrize("axis", ["yaw", "roll", "pitch"])
def test_an_angle_says_its_sign(properties: Properties, axis: str) -> None:
    angles = [content["description"] for _, field, content in properties if field == f"{axis}_deg"]
    assert len(angles) >= 10
    assert all("positive" in text for text in angles), angles


def test_every_meaning_is_used(properties: Properties) -> None:
    of_schemas = {f"{name.removesuffix('Input')}.{field}" for name, field, _ in properties}
    of_schemas |= {f"{name}.{field}" for name, field, _ in properties}
    fields = {field for _, field, _ in properties}
    assert [name for name in MEANINGS if name not in (of_schemas if "." in name else fields)] == []


def test_a_description_of_the_record_goes_before_the_table() -> None:
    schemas = {"One": {"properties": {"yaw_deg": {"description": "Mean angle."}, "roll_deg": {}, "odd": {}}}}
    describe_properties(schemas)
    described = {name: content["description"] for name, content in schemas["One"]["properties"].items()}
    assert described == {"yaw_deg": "Mean angle; deg.", "roll_deg": MEANINGS["roll_deg"][:-1] + "; deg.", "odd": ""}


def test_every_operation_and_shape_stands_on_the_page(document: dict[str, Any]) -> None:
    page = render_page(document)
    for path, operations in document["paths"].items():
        assert path in page
        for operation in operations.values():
            assert operation.get("summary", "") in page
    for name in document["components"]["schemas"]:
        assert f"id='{name}'" in page


def test_the_page_loads_nothing_from_elsewhere(document: dict[str, Any]) -> None:
    page = render_page(document)
    assert "<script" not in page
    assert "http://" not in page
    assert "https://" not in page


def test_text_of_the_document_cannot_become_markup():
    document = {
        "info": {"title": "<b>", "version": "1"},
        "paths": {"/x": {"get": {"summary": "<script>", "responses": {"200": {"description": "<i>"}}}}},
    }
    page = render_page(document)
    assert "<script>" not in page
    assert "<i>" not in page
    assert "&lt;script&gt;" in page


class Held:
    """Installed distribution with some metadata."""

    version = "1.2"

    def __init__(self, name, requires=None, **stated):
        self.requires = requires
        self.metadata = Message()
        self.metadata["Name"] = name
        for key, values in stated.items():
            for value in values:
                self.metadata[key.replace("_", "-")] = value


WORLD = {
    "soo": Held(
        "soo",
        ["Some_Lib[binary]>=2; python_version >= '3.9'", "youplot==1.0.0; extra == 'console'", "tool; extra=='study'"],
        License_Expression=["Apache-2.0"],
    ),
    "some-lib": Held("Some.Lib", ["soo", "absent>1"], License=["A licence\nwith its text " + "x" * 5000]),
    "youplot": Held("youplot", Classifier=["License :: OSI Approved :: MIT License", "Framework :: None"]),
    "tool": Held("tool", License=["never shipped"]),
}


@pytest.fixture
def world(monkeypatch):
    """A few distributions in place of those that are installed."""
    held = dict(WORLD)

    def found(name):
        if name not in held:
            raise PackageNotFoundError(name)
        return held[name]

    shipped.shipped_distributions.cache_clear()
    monkeypatch.setattr(shipped, "distribution", found)
    yield held
    shipped.shipped_distributions.cache_clear()


def test_what_is_needed_is_followed_round_circles(world):
    assert shipped.shipped_distributions() == (
        ("soo", "1.2", "Apache-2.0"),
        ("Some.Lib", "1.2", "A licence"),
        ("youplot", "1.2", "MIT License"),
    )
    assert shipped.program_version() == "1.2"


def test_a_program_that_is_not_installed(world):
    del world["soo"]
    assert shipped.shipped_distributions() == ()
    assert shipped.program_version() == "unknown"


def test_what_others_write_is_bounded(world):
    world["soo"] = Held("soo", [f"part{k}" for k in range(1000)], License_Expression=["x" * 1000])
    for k in range(1000):
        world[f"part{k}"] = Held(f"part{k}")
    found = shipped.shipped_distributions()
    assert len(found) == 300
    assert len(found[0].licence) == 200
    assert found[1].licence is None
