"""Traces in the format that the analyzer takes: blocks of numbers, text, and text in blocks.

Law of this file: a trace has as many levels as the analyzer states points, or it is no trace. The trace's own number
counts only where the analyzer states none, or belongs to a family that is known to state wrong ones.
"""

import numpy as np

from service.frontend.drivers.configuration import Configuration
from service.frontend.drivers.dialects import Dialect, SweepRefusedError
from service.frontend.drivers.dialogue import Dialogue
from service.frontend.drivers.scpi import (
    AnswerError,
    FloatArray,
    is_message,
    levels_of_block,
    levels_of_text,
    parse_message,
    split_answers,
)
from service.frontend.drivers.visa_session import AnalyzerIOError

#: what an analyzer sends that has no trace yet
_NO_TRACE = "#0"
#: no input stands more than 10 W; 107 dB more is what microvolts show
_MOST_DBM = 40.0
#: a trace of fewer points is none
FEWEST_POINTS = 11
#: a trace that keeps this close to zero is one in watts or volts
_FLAT_DB = 0.1


class TraceReader:
    """Reads the traces of one session.

    Parameters
    ----------
    dialogue : Dialogue
        Questions and answers.
    dialect : Dialect
        Words of the family.
    configuration : Configuration
        Knows the format in which traces are sent.
    """

    def __init__(self, dialogue: Dialogue, dialect: Dialect, configuration: Configuration) -> None:
        self._dialogue = dialogue
        self._dialect = dialect
        self._configuration = configuration

    def read(self, further: list[str]) -> tuple[bytes | str, list[str]]:
        """Return the trace as it came, and the answers to further queries, the last one the error queue's."""
        payload, line = self._dialogue.session.query_block(";".join([self._dialect.trace_query, *further]))
        answers = split_answers(line)
        if len(answers) != 1 + len(further):
            if is_message(answers[-1]):
                self._dialogue.raise_on_errors("the trace", parse_message(answers[-1]))
            reason = f"{len(answers)} answers to {1 + len(further)} queries: {line[-120:]!r}"
            raise AnalyzerIOError(f"{self._dialogue.session.resource} gave {reason}")
        first = answers.pop(0)
        if payload is None and first.strip() in {_NO_TRACE, ""}:
            raise SweepRefusedError(f"{self._dialogue.session.resource} has no trace to give")
        return (first if payload is None else payload), answers

    def levels(self, trace: bytes | str, points: int) -> FloatArray:
        """Return the levels of a trace, dBm.

        Raises
        ------
        AnswerError
            The trace does not have so many points.
        """
        levels = self._read_levels(trace, points)
        _require_dbm(levels)
        return levels

    def _read_levels(self, trace: bytes | str, points: int) -> FloatArray:
        """Return the numbers of a trace."""
        wanted = self._configuration.format
        if isinstance(trace, str) or not wanted.is_binary:
            return self._of_text(trace if isinstance(trace, str) else trace.decode("ascii"), points)
        if len(trace) == 8 * points or len(trace) % 4:
            # Doubles, or something that is no floats at all: the analyzer did not mean the format that it took.
            return self._again_as_text(points)
        return levels_of_block(trace, points, is_big_endian=wanted.is_big_endian)

    def _again_as_text(self, points: int) -> FloatArray:
        """Ask for the same trace as text, from now on."""
        self._configuration.read_text()
        payload, line = self._dialogue.session.query_block(self._dialect.trace_query)
        return self._of_text(line if payload is None else payload.decode("ascii"), points)

    def _of_text(self, text: str, points: int) -> FloatArray:
        """Return the levels of text; its own number of them where the analyzer states none, or a wrong one as known."""
        own = len(text.strip().strip(",").split(","))
        is_own = own == self._dialect.fixed_points or (not self._configuration.has_points and own >= FEWEST_POINTS)
        return levels_of_text(text, own if is_own else points)


def _require_dbm(levels: FloatArray) -> None:
    """Raise when a trace cannot be in dBm, whatever unit the analyzer says."""
    present = levels[np.isfinite(levels)]
    if present.size and (present.max() > _MOST_DBM or np.abs(present).max() < _FLAT_DB):
        message = f"levels from {present.min():g} to {present.max():g} are not in dBm"
        raise AnswerError(message)
