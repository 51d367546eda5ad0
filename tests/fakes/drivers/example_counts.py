"""Numbers of examples of tests that search: all in continuous integration and at night, a quarter at every run."""

import os


def examples(full: int) -> int:
    """Return how many of so many examples the profile of this run asks for, ten at least."""
    return min(full, max(10, full // 4)) if os.environ.get("SOO_TEST_PROFILE", "fast") == "fast" else full
