"""Faults: what pydantic found wrong with a request, in the words of this interface.

Codes of our own validators contain a dot and pass unchanged; pydantic's many types fold into a few stable ones.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from service.errors import FieldError
from service.records.field_faults import fault_sentence

#: an answer names at most so many faults; the rest would only make it long
MAX_FAULTS = 50

_CODE_OF = {
    "extra_forbidden": "field.unknown",
    "missing": "field.missing",
    "finite_number": "value.not_finite",
    "too_short": "value.length",
    "too_long": "value.length",
    "string_too_short": "value.length",
    "string_too_long": "value.length",
    "string_pattern_mismatch": "value.pattern",
    "literal_error": "value.choice",
    "enum": "value.choice",
    "greater_than": "value.range",
    "greater_than_equal": "value.range",
    "less_than": "value.range",
    "less_than_equal": "value.range",
    "int_parsing_size": "value.range",
}


def faults_of(errors: Sequence[Mapping[str, Any]], prefix: str = "") -> tuple[FieldError, ...]:
    """Return the field errors of a pydantic validation, the first ``MAX_FAULTS`` of them."""
    shown = errors[:MAX_FAULTS]
    return tuple(_fault(error, prefix) for error in shown if not _is_echo(error, shown))


def _is_echo(error: Mapping[str, Any], errors: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a sequence is called too short only because its elements failed and were not counted."""
    position = tuple(error["loc"])
    if error["type"] != "too_short":
        return False
    return any(
        len(other["loc"]) > len(position) and tuple(other["loc"])[: len(position)] == position for other in errors
    )


def pointer_of(location: Sequence[str | int]) -> str:
    """Return the JSON pointer of RFC 6901 to a place.

    Examples
    --------
    >>> pointer_of(("carriers", 3, "a/b"))
    '/carriers/3/a~1b'
    """
    return "".join(f"/{str(part).replace('~', '~0').replace('/', '~1')[:100]}" for part in location)


def _fault(error: Mapping[str, Any], prefix: str) -> FieldError:
    """Return one field error."""
    kind = str(error["type"])
    code = kind if "." in kind else _CODE_OF.get(kind, "value.type")
    return FieldError(prefix + pointer_of(error["loc"]), code, fault_sentence(error))
