"""Method that runs on every row: the one that a request names where smoothed rows are no answer."""

from typing import Annotated

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

from service.records.catalogue import LIVE_METHODS, Method


def _live(method: Method) -> Method:
    """Refuse a method that does not run on every row."""
    if method not in LIVE_METHODS:
        detail = "smoothed rows run on no measurement and drive no control"
        raise PydanticCustomError("method.smoothed", detail)
    return method


LiveMethod = Annotated[Method, AfterValidator(_live)]
