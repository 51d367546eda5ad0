"""A world that stands still, an instrument on it and a line to talk to it, without a socket."""

from collections.abc import Callable

import pytest
from standing_source import StandingSource

from analyzer_sim.dialects.dialect import Dialect
from analyzer_sim.dialects.rs import RS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.lines.session import Session, command_tree
from analyzer_sim.scpi.framing import MessageFramer


class Bench:
    """An instrument and one session, as a client sees them; counts what the world was asked."""

    def __init__(
        self, source: StandingSource, *, may_advance: Callable[[], bool] = lambda: True, dialect: Dialect = RS
    ) -> None:
        self.source = source
        self.dialect = dialect
        self.instrument = Instrument(source, TracePainter(7, IDEAL), may_advance, dialect.model)
        self.framer = MessageFramer()
        self.session = self.new_session()

    def new_session(self) -> Session:
        return Session(self.instrument, self.dialect, command_tree(self.dialect))

    def send(self, data: bytes | str) -> bytes:
        """Feed bytes, return all that came back; a held session stays held."""
        out = b""
        for message in self.framer.feed(data if isinstance(data, bytes) else data.encode() + b"\n"):
            self.session.submit(message)
            out += self.go_on()
        return out

    def go_on(self) -> bytes:
        """Run the session until it is finished or held."""
        out = self.session.run() or b""
        while self.session.is_busy and not self.session.is_held:
            out += self.session.run() or b""
        return out

    def ask(self, text: str) -> str:
        """Return the one line that answers; empty when nothing does."""
        return self.send(text).decode("latin-1").removesuffix("\n")

    def errors(self) -> list[int]:
        """Empty the error queue and return its codes."""
        codes = []
        while (code := int(self.ask("SYST:ERR?").split(",", 1)[0])) != 0:
            codes.append(code)
        return codes


@pytest.fixture
def bench() -> Bench:
    return Bench(StandingSource())


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    def make(may_advance: Callable[[], bool] = lambda: True, dialect: Dialect = RS, **source: object) -> Bench:
        return Bench(StandingSource(**source), may_advance=may_advance, dialect=dialect)

    return make
