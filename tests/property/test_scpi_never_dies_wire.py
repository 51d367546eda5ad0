"""The same messages over live lines: the raw socket and HiSLIP never close, never hang and go on answering."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scpi_bench import standing_instrument
from scpi_soup import KINDS
from wire_lines import HislipLine, RawLine

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.scpi.framing import MessageFramer

pytestmark = pytest.mark.system

EXAMPLES = examples(150)
NIGHTLY_EXAMPLES = 1000
_NONCES = itertools.cycle(range(1, 128))


@pytest.fixture(params=sorted(DIALECTS))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def analyzer(name: str) -> Iterator[AnalyzerThread]:
    dialect = DIALECTS[name]
    with start_in_thread(standing_instrument(dialect), dialect=dialect, hislip_port=0) as handle:
        yield handle


class SocketThrower:
    """Throws bytes at one connection for as long as it lives."""

    def __init__(self, analyzer: AnalyzerThread, identity: str) -> None:
        self.line = RawLine(analyzer.port)
        self._identity = identity
        self._analyzer = analyzer
        #: knows what stands open, as a client knows that forgot a quote
        self._framer = MessageFramer()

    def throw(self, data: bytes) -> None:
        """Send bytes, close what stands open, ask who is there."""
        self._analyzer.instrument.settings.points = 101
        self._framer.feed(data)
        close = self._framer.missing + b"\n\n"
        self._framer.feed(close)
        nonce = next(_NONCES)
        self.line.write(data + close + f"*ESE {nonce};*IDN?;*ESE?\n".encode())
        self.line.read_until(f"{self._identity};{nonce}\n".encode())


class HislipThrower:
    """Throws messages at one session for as long as it lives; the end of a message closes what stands open."""

    def __init__(self, analyzer: AnalyzerThread, identity: str) -> None:
        self.line = HislipLine(analyzer.hislip_port or 0)
        self._identity = identity
        self._analyzer = analyzer

    def throw(self, data: bytes) -> None:
        """Send a message, clear the device, ask who is there."""
        self._analyzer.instrument.settings.points = 101
        self.line.write(data)
        self.line.clear()
        nonce = next(_NONCES)
        assert self.line.ask(f"*ESE {nonce};*IDN?;*ESE?") == f"{self._identity};{nonce}"


THROWERS: list[Callable[[AnalyzerThread, str], SocketThrower | HislipThrower]] = [SocketThrower, HislipThrower]


def fuzz(
    analyzer: AnalyzerThread, name: str, make: Callable[..., SocketThrower | HislipThrower], examples: int
) -> None:
    """Throw examples of all kinds at one line; the repeatable ones when they are few."""
    kinds = st.one_of(*(kind(name) for kind in KINDS.values()))
    thrower = make(analyzer, DIALECTS[name].identity)
    with closing(thrower.line):
        check = given(kinds)(thrower.throw)
        options = settings(
            max_examples=examples,
            deadline=None,
            derandomize=examples == EXAMPLES,
            database=None,
            suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no fault of the strategy
        )
        options(check)()


@pytest.mark.parametrize("make", THROWERS)
def test_anything_leaves_the_line_alive(
    analyzer: AnalyzerThread, name: str, make: Callable[..., SocketThrower]
) -> None:
    fuzz(analyzer, name, make, EXAMPLES)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("make", THROWERS)
def test_nightly_anything_leaves_the_line_alive(
    analyzer: AnalyzerThread, name: str, make: Callable[..., SocketThrower]
) -> None:
    fuzz(analyzer, name, make, NIGHTLY_EXAMPLES)


def test_bytes_that_are_no_hislip_end_only_their_own_session(analyzer: AnalyzerThread, name: str) -> None:
    neighbour = HislipLine(analyzer.hislip_port or 0)

    @given(data=st.binary(min_size=16, max_size=200), is_first=st.booleans())
    @settings(max_examples=EXAMPLES, deadline=None, derandomize=True, database=None)
    def throw(data: bytes, is_first: bool) -> None:
        line = RawLine(analyzer.hislip_port or 0) if is_first else HislipLine(analyzer.hislip_port or 0)
        (line.socket if isinstance(line, RawLine) else line.synchronous).sendall(data)
        line.close()
        assert neighbour.ask("*IDN?") == DIALECTS[name].identity

    throw()
    neighbour.close()
