"""Refused rows of a batch whose other rows were stored."""

from typing import Self

from service.api.problems.next_steps import NEXT_STEPS
from service.api.schemas.base import Answer


class RefusalAnswer(Answer):
    """A refused row."""

    index: int
    code: str
    detail: str
    next_step: str
    """Action that the code asks of the sender."""

    @classmethod
    def of_fault(cls, index: int, fault: tuple[str, str]) -> Self:
        """Return the answer for a row that is refused with a code and a detail."""
        code, detail = fault
        return cls(index=index, code=code, detail=detail, next_step=NEXT_STEPS.get(code, ""))
