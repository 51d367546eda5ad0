"""Notes of the shift log."""

from typing import Annotated

from pydantic import Field, StringConstraints

from service.api.context.dependencies import SPACECRAFT_ID_PATTERN
from service.api.schemas.base import Answer, Document, Epoch, Name, RowPage
from service.api.schemas.record_answers import members_of
from service.records.operations.note import Note

MAX_TAGS = 16
NoteText = Annotated[
    str, StringConstraints(min_length=1, max_length=8000, pattern=r"^[^\x00-\x08\x0b\x0c\x0e-\x1f\x7f]*$")
]


class NoteDocument(Document):
    """A note; it cannot be changed, a later one may correct it."""

    text: NoteText
    spacecraft_id: Annotated[str, StringConstraints(pattern=SPACECRAFT_ID_PATTERN)] | None = None
    epoch: Epoch | None = None
    """Instant that it is about; default now, by the spacecraft's clock."""
    tags: list[Name] = Field(default_factory=list, max_length=MAX_TAGS)
    corrects: Annotated[int, Field(ge=1, le=2**53)] | None = None
    """Id of the note that this one corrects."""


class NoteAnswer(members_of(Note), Answer):
    """A note."""


class NotePage(RowPage):
    """One page of notes."""

    rows: list[NoteAnswer]
