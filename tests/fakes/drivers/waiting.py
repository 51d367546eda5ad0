"""Waiting for what another thread or process does."""

import time
from collections.abc import Callable
from typing import Any


def wait_until(is_reached: Callable[[], Any], what: object = "it", patience_s: float = 480.0) -> Any:
    """Return the first answer that is not empty; ``what`` is said when it does not come."""
    deadline_s = time.monotonic() + patience_s
    while not (found := is_reached()):
        assert time.monotonic() < deadline_s, f"waited {patience_s} s for {what() if callable(what) else what}"
        time.sleep(0.01)
    return found
