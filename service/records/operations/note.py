"""Notes of the shift log: append only; who errs writes a new note that names the old one."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Note:
    """One note."""

    #: global; 0 until it is stored
    id: int
    #: None: it concerns no spacecraft or all
    spacecraft_id: str | None
    #: instant that it is about, microseconds UTC
    epoch_us: int
    written_at_us: int
    author: str
    text: str
    tags: tuple[str, ...] = ()
    #: the note that this one corrects
    corrects: int | None = None
