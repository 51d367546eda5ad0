"""Questions and answers with one analyzer: several queries a message, the error queue, and what is known at all.

Law of this file: a query that may be unknown goes out together with one that is not, so that the analyzer always
answers and no time-out has to be waited for. An analyzer that does not answer the queries of one message in one line
gets one query a message.
"""

from collections.abc import Sequence

from service.frontend.drivers.dialects import SweepRefusedError, Word
from service.frontend.drivers.scpi import AnalyzerMessage, parse_message, split_answers
from service.frontend.drivers.visa_session import AnalyzerIOError, VisaSession

#: the queue holds 20 to 30 entries; more means that it never empties
MAX_QUEUE = 64


class Dialogue:
    """Questions and answers over one session.

    Parameters
    ----------
    session : VisaSession
        Open session.
    """

    def __init__(self, session: VisaSession) -> None:
        self.session = session
        #: errors of the analyzer that did not spoil a sweep, oldest first; the caller empties it
        self.analyzer_messages: list[AnalyzerMessage] = []
        #: whether the queries of one message are answered in one line
        self.is_joining = True
        self._identity = ""

    def find_out_joining(self) -> None:
        """Find out whether the analyzer answers the queries of one message in one line."""
        answers = split_answers(self.session.query("*OPC?;:SYST:ERR?"))
        self.is_joining = len(answers) > 1
        if self.is_joining:
            return
        if answers[0].lstrip("+") == "1":
            # the second answer comes on a line of its own
            self.session.read_line(":SYST:ERR?")
        self._identity = self.session.query("*IDN?")

    def report(self, message: str) -> None:
        """Send one message that asks for nothing."""
        self.session.write(message)

    def ask(self, queries: Sequence[str]) -> list[str]:
        """Return the answers to queries that the analyzer knows."""
        if not self.is_joining:
            return [self.session.query(query).strip() for query in queries]
        message = ";".join(queries)
        answers = split_answers(self.session.query(message))
        if len(answers) != len(queries):
            reason = f"{len(answers)} answers to {len(queries)} queries {message!r}: {answers}"
            raise AnalyzerIOError(f"{self.session.resource} gave {reason}")
        return answers

    def try_ask(self, query: str) -> str | None:
        """Return the answer to a query that may be unknown; None when it is, empty when there is nothing to say."""
        answers = split_answers(self.session.query(f"*OPC?;{query}"))[1:] if self.is_joining else self._each(query)
        if answers:
            return ";".join(answers)
        # A query that is known but has nothing to say now leaves an execution error, not a command error.
        return None if any(entry.is_command_error for entry in self.drain()) else ""

    def _each(self, queries: str) -> list[str]:
        """Return the answers to queries that may be unknown, asked one by one; none as soon as one is not answered."""
        answers = []
        for query in queries.split(";"):
            self.session.write(query)
            answer = self.session.query("*IDN?").strip()
            if answer == self._identity.strip():
                return []
            self.session.read_line("*IDN?")
            answers.append(answer)
        return answers

    def try_set(self, word: Word) -> bool | None:
        """Set a word and read it back: whether it stands, None when the analyzer took it but cannot be asked."""
        self.report(f"{word.header} {word.value}")
        if any(entry.is_command_error or entry.is_execution_error for entry in self.drain()):
            return False
        answer = self.try_ask(f"{word.header}?")
        return None if answer is None else word.stands(answer)

    def drain(self, first: AnalyzerMessage | None = None) -> list[AnalyzerMessage]:
        """Return all entries of the error queue."""
        entries: list[AnalyzerMessage] = []
        entry = first or parse_message(self.session.query(":SYST:ERR?"))
        while entry.code != 0:
            entries.append(entry)
            if len(entries) > MAX_QUEUE:
                raise AnalyzerIOError(f"{self.session.resource} has an error queue without end")
            entry = parse_message(self.session.query(":SYST:ERR?"))
        return entries

    def raise_on_errors(self, what: str, first: AnalyzerMessage | None = None) -> None:
        """Drain the error queue; raise when an entry says that something was not done."""
        entries = self.drain(first)
        refusals = [entry for entry in entries if entry.is_execution_error or entry.is_command_error]
        if refusals:
            reported = "; ".join(f"{entry.code} {entry.text}" for entry in refusals)
            raise SweepRefusedError(f"{self.session.resource} refuses {what}: {reported}")
        self.analyzer_messages += entries
