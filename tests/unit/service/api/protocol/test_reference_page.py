"""The reference page names everything the OpenAPI document does and calls nobody."""

import json

from service.api.app import render_openapi
from service.api.protocol.reference_page import render_page


def test_every_operation_and_shape_stands_on_the_page():
    document = json.loads(render_openapi())
    page = render_page(document)
    for path, operations in document["paths"].items():
        assert path in page
        for operation in operations.values():
            assert operation.get("summary", "") in page
    for name in document["components"]["schemas"]:
        assert f"id='{name}'" in page


def test_the_page_loads_nothing_from_elsewhere():
    page = render_page(json.loads(render_openapi()))
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
