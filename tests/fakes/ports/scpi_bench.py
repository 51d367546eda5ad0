"""An instrument on a world that stands still, and lines to it: in the process, without a socket."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

from standing_source import StandingSource

from analyzer_sim.dialects.dialect import Command, Dialect
from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.instrument.imperfections import IDEAL
from analyzer_sim.instrument.instrument import Instrument
from analyzer_sim.instrument.painter import TracePainter
from analyzer_sim.lines.dispatcher import Session, command_tree
from analyzer_sim.scpi.framing import MessageFramer
from analyzer_sim.scpi.tree import CommandTree


@cache
def tree_of(name: str) -> CommandTree[Command]:
    """Return the commands of a dialect; one tree serves all sessions."""
    return command_tree(DIALECTS[name])


def standing_instrument(
    dialect: Dialect, source: StandingSource | None = None, may_advance: Callable[[], bool] = lambda: True
) -> Instrument:
    """Return an instrument without errors of its own."""
    return Instrument(source or StandingSource(), TracePainter(7, IDEAL), may_advance, dialect.model)


def block_payload(data: bytes) -> bytes:
    """Read ``#<n><length>``, the payload and the line feed; return the payload."""
    digits = int(data[1:2])
    size = int(data[2 : 2 + digits])
    assert data[:1] == b"#"
    assert len(data) == 2 + digits + size + 1
    assert data.endswith(b"\n")
    return data[2 + digits : -1]


class Bench:
    """An instrument and one session on it; ``allow(False)`` keeps sweeps pending."""

    def __init__(
        self,
        name: str,
        *,
        is_lenient: bool = False,
        is_error_queue_per_session: bool = False,
        **source: Any,
    ) -> None:
        model = replace(DIALECTS[name].model, is_error_queue_per_session=is_error_queue_per_session)
        dialect = replace(DIALECTS[name], is_lenient=is_lenient, model=model)
        self.dialect = dialect
        self.source = StandingSource(**source)
        self.is_allowed = True
        self.instrument = standing_instrument(dialect, self.source, lambda: self.is_allowed)
        self._tree = command_tree(dialect) if is_lenient else tree_of(name)
        self.framer = MessageFramer()
        self.session = self.new_session()

    def new_session(self) -> Session:
        """Return another client's session on the same instrument."""
        return Session(self.instrument, self.dialect, self._tree)

    def allow(self, is_allowed: bool) -> None:
        """Let sweeps complete, or keep them pending from now on."""
        self.is_allowed = is_allowed
        if is_allowed:
            self.instrument.complete_pending()

    def send(self, data: bytes) -> bytes:
        """Feed bytes; return all that came back. A held session stays held."""
        answers = b""
        for message in self.framer.feed(data):
            self.session.submit(message)
            answers += self.go_on()
        return answers

    def go_on(self) -> bytes:
        """Run the session until it is finished or held."""
        answers = self.session.run() or b""
        while self.session.is_busy and not self.session.is_held:
            answers += self.session.run() or b""
        return answers

    def ask(self, text: str) -> str:
        """Send one message; return the line that answers, empty when nothing does."""
        return self.send(text.encode("latin-1") + b"\n").decode("latin-1").removesuffix("\n")

    def errors(self) -> list[int]:
        """Empty the error queue; return its codes."""
        codes = []
        while (code := int(self.ask("SYST:ERR?").split(",", 1)[0])) != 0:
            codes.append(code)
        return codes
