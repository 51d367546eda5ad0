"""The reference of the REST interface as one page: the OpenAPI document for people, with no script on it."""

from html import escape
from typing import Any

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
    """Return one shape with its fields."""
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
