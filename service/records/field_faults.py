"""Field faults: sentences on what pydantic refused in a document, a setting or a task.

A sentence says what the field must be, and never what was sent: one of the values is a key.
"""

from collections.abc import Iterable, Mapping
from typing import Any

_SENTENCE_OF = {
    "missing": "this field is required",
    "extra_forbidden": "unknown field; check its spelling or leave it out",
    "finite_number": "NaN, Infinity and numbers beyond the range of float64 are not accepted",
    "too_long": "must have at most {max_length} entries",
    "too_short": "must have at least {min_length} entries",
    "string_too_long": "must have at most {max_length} characters",
    "string_too_short": "must have at least {min_length} characters",
    "string_pattern_mismatch": "must fit the pattern {pattern}",
    "literal_error": "must be {expected}",
    "enum": "must be {expected}",
    "union_tag_invalid": "must be {expected_tags}",
    "union_tag_not_found": "must state {discriminator}",
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be {ge} or greater",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be {le} or less",
    "multiple_of": "must be a multiple of {multiple_of}",
    "int_parsing_size": "must be a whole number of at most 64 bits",
    "none_required": "must be null",
    "json_invalid": "is not JSON: {error}",
    "date_from_datetime_inexact": "must be a date without a time",
    "timezone_aware": "must have an offset from UTC, such as Z",
    "value_error": "{error}",
}
#: kinds of pydantic by their first word, where no sentence of their own stands above
_KIND_OF = {
    "int": "must be a whole number",
    "float": "must be a number",
    "decimal": "must be a number",
    "string": "must be a text",
    "bool": "must be true or false",
    "list": "must be a list",
    "tuple": "must be a list",
    "set": "must be a list",
    "frozen": "must be a list",
    "iterable": "must be a list",
    "dict": "must be an object",
    "mapping": "must be an object",
    "model": "must be an object",
    "dataclass": "must be an object",
    "datetime": "must be an instant as RFC 3339 writes it",
    "date": "must be a date, YYYY-MM-DD",
    "time": "must be a span of time",
    "path": "must be a path",
    "url": "must be an address, such as http://127.0.0.1:8000",
    "bytes": "must be a text",
}
_ELSE = "must be of another type; see the OpenAPI document or the reference of settings"


class _Context(dict[str, Any]):
    """Context of a fault by name; an ellipsis where pydantic states nothing, so that no answer fails for it."""

    def __missing__(self, name: str) -> str:
        return "..."


def fault_sentence(fault: Mapping[str, Any]) -> str:
    """Return the sentence of one fault; those of our own validators stay as they are.

    Examples
    --------
    >>> fault_sentence({"type": "too_long", "ctx": {"field_type": "Tuple", "max_length": 2, "actual_length": 3}})
    'must have at most 2 entries'
    >>> fault_sentence({"type": "float_parsing"})
    'must be a number'
    """
    kind = str(fault["type"])
    if "." in kind:
        return str(fault["msg"])
    sentence = _SENTENCE_OF.get(kind) or _KIND_OF.get(kind.partition("_")[0], _ELSE)
    return sentence.format_map(_Context(fault.get("ctx") or {}))


def faults_text(faults: Iterable[Mapping[str, Any]], whole: str = "document") -> str:
    """Return all faults with their places in one line.

    Parameters
    ----------
    faults : Iterable
        As pydantic lists them, with their context.
    whole : str
        Place of a fault of the whole document.
    """
    return "; ".join(f"{'.'.join(map(str, each['loc'])) or whole}: {fault_sentence(each)}" for each in faults)
