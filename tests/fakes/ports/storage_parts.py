"""A storage of which one part does something of a test's own."""

from types import SimpleNamespace


class Part:
    """A part of a storage some of whose methods are those of a test."""

    def __init__(self, inner, methods):
        self._inner = inner
        vars(self).update(methods)

    def __getattr__(self, name):
        return getattr(self._inner, name)


def with_part(storage, name, **methods):
    """Return what the runtime uses of a storage, one part with methods of a test's own."""
    parts = {part: getattr(storage, part) for part in ("catalogue", "archive", "results")}
    return SimpleNamespace(**{**parts, name: Part(parts[name], methods)})
