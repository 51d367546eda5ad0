"""Merge patch (RFC 7396): the fields that a PATCH names change, objects merge at every depth, null restores a default.

The result is validated as a whole document, so a PATCH can reach nothing that a POST could not.
"""

import json
from typing import Any, TypeVar

from pydantic import BaseModel, RootModel, TypeAdapter

from service.api.protocol.bodies import decode

M = TypeVar("M", bound=BaseModel)


class MergePatch(RootModel[dict[str, Any]]):
    """Fields to change; objects are merged at every depth, null restores a default (RFC 7396)."""


def patched(adapter: TypeAdapter[M], document: dict[str, Any], patch: MergePatch) -> M:
    """Return a document with a patch applied.

    Parameters
    ----------
    adapter : TypeAdapter
        Validates the result.
    document : dict
        What is stored, as JSON.
    patch : MergePatch
        What changes.
    """
    # a NaN passes through as the token NaN, so that the check of the result names its field
    merged = json.dumps(merge(document, patch.root))
    return decode(adapter, merged.encode())


def merge(target: Any, patch: Any) -> Any:
    """Return a JSON value with a merge patch applied; the target stays as it is.

    Examples
    --------
    >>> merge({"a": {"b": 1, "c": 2}}, {"a": {"b": None, "d": 3}})
    {'a': {'c': 2, 'd': 3}}
    """
    if not isinstance(patch, dict):
        return patch
    result = dict(target) if isinstance(target, dict) else {}
    for key, value in patch.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merge(result.get(key), value)
    return result
