"""Golden transcripts: one dialogue a maker, written by hand from the specification's facts, replayed word for word.

Lines of a transcript::

    > message     sent to the session                     ! hold      sweeps stay pending from here on
    < answer      the whole answer, exactly               ! allow     they complete; a held session then goes on
    ~ pattern     the whole answer, a regular expression  ! session N talk on session N from here on
    # remark

A message without an answer below it must answer nothing.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from dialect_facts import FACTS
from scpi_bench import Bench

FOLDER = Path(__file__).parent / "transcripts"


class Replay:
    """Plays a transcript against a bench."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._sessions = {"1": bench.session}
        self._unread = b""

    def play(self, lines: Iterator[tuple[int, str]]) -> int:
        """Play all lines; return how many answers were compared."""
        compared = 0
        for number, line in lines:
            sign, _, text = line.partition(" ")
            if sign in "<~":
                self._compare(number, sign, text)
                compared += 1
            elif line and sign != "#":
                assert self._unread == b"", f"line {number}: an answer that was not expected"
                {">": self._send, "!": self._control}[sign](text)
        assert self._unread == b""
        return compared

    def _compare(self, number: int, sign: str, text: str) -> None:
        answer = self._unread.decode("latin-1")
        self._unread = b""
        expected = re.escape(text) if sign == "<" else text
        assert re.fullmatch(f"(?:{expected})\n", answer), f"line {number}: {answer[:200]!r}"

    def _send(self, text: str) -> None:
        self._unread = self._bench.send(text.encode("latin-1") + b"\n")

    def _control(self, text: str) -> None:
        word, _, argument = text.partition(" ")
        if word == "session":
            self._bench.session = self._sessions.setdefault(argument, self._bench.new_session())
        else:
            self._bench.allow({"hold": False, "allow": True}[word])
            self._unread = self._bench.go_on() if self._bench.session.is_held else b""


def test_every_dialect_has_a_transcript() -> None:
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(FACTS)


def test_transcript_is_what_the_instrument_says(name: str) -> None:
    lines = enumerate((FOLDER / f"{name}.txt").read_text().splitlines(), start=1)
    assert Replay(Bench(name)).play(lines) > 35


@pytest.mark.parametrize(
    ("line", "fault"), [("> *ESE?\n< 1", "line 2"), ("> *ESE?\n> *ESE?", "line 2"), ("~ 1", "line 1")]
)
def test_transcript_that_lies_is_noticed(line: str, fault: str) -> None:
    with pytest.raises(AssertionError, match=fault):
        Replay(Bench("rs")).play(enumerate(line.splitlines(), start=1))
