"""Any bytes at all: the simulated analyzer neither raises nor falls silent, and its memory stays bounded."""

import itertools

from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer_sim.dialect_rs import IDENTITY, RS
from analyzer_sim.emission import Emission, Signal
from analyzer_sim.instrument import Instrument
from analyzer_sim.painter import TracePainter
from analyzer_sim.scpi import MessageFramer
from analyzer_sim.scpi_tree import parse_pattern
from analyzer_sim.session import Session, command_tree
from analyzer_sim.status import ERROR_QUEUE_DEPTH

EXAMPLES = 2000
TREE = command_tree(RS)
_SIGNALS = (Signal("a", 1017e6, 1e6, 0.25, -40.0), Signal("line", 1020e6, 0.0, 0.0, -50.0))


class EndlessSource:
    """The same two signals for ever."""

    def __init__(self) -> None:
        self._rows = itertools.count()

    def advance(self) -> Emission:
        return Emission(60_000_000 * next(self._rows), _SIGNALS, -140.0)

    def current(self) -> Emission:
        return Emission(0, _SIGNALS, -140.0)


class Line:
    """An instrument of few points and a session on it."""

    def __init__(self) -> None:
        self.instrument = Instrument(EndlessSource(), TracePainter(1))
        self.instrument.settings.points = 101
        self.framer = MessageFramer()
        self.session = Session(self.instrument, RS, TREE)

    def send(self, data: bytes) -> list[bytes]:
        answers = []
        for message in self.framer.feed(data):
            self.session.submit(message)
            answers.append(self.session.run())
            while self.session.is_busy:
                assert not self.session.is_held, "nothing can be pending: every row is allowed"
                answers.append(self.session.run())
        return [answer for answer in answers if answer is not None]

    def assert_alive(self) -> None:
        """The next question is answered, once what stands open is closed."""
        self.send(self.framer.missing + b"\n")
        self.send(b"\n")
        assert self.framer.pending_bytes == 0
        assert self.send(b"*IDN?\n") == [IDENTITY.encode() + b"\n"]
        assert self.instrument.status.error_count <= ERROR_QUEUE_DEPTH


@given(chunks=st.lists(st.binary(max_size=60), max_size=6))
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
def test_arbitrary_bytes_leave_the_instrument_alive(chunks: list[bytes]) -> None:
    line = Line()
    for chunk in chunks:
        for answer in line.send(chunk):
            assert answer.endswith(b"\n")
    line.assert_alive()


def _spellings() -> list[str]:
    """Return a short and a long spelling of every header of the dialect."""
    headers = []
    for row in RS.commands:
        nodes = parse_pattern(row.pattern)
        headers.append(":".join(node.names[0] for node in nodes if not node.is_optional))
        headers.append(":".join(node.names[-1] for node in nodes))
    return sorted(set(headers))


# fewer points than 101 and no sweep of more: one example must not cost a second
_HEADERS = [header for header in _spellings() if "POIN" not in header and "COUN" not in header]
_DATA = [
    "1",
    "-1",
    "1e3",
    "30kHz",
    "1e99",
    "1e40000",
    "0",
    "MIN",
    "MAX",
    "DEF",
    "UP",
    "DOWN",
    "INF",
    "NINF",
    "ON",
    "OFF",
    "RMS",
    "POS",
    "NEG",
    "SAMP",
    "AVER",
    "APE",
    "FFT",
    "REAL",
    "ASC",
    "32",
    "REAL,32",
    "TRACE1",
    "TRACE2",
    "'SAN'",
    "'",
    '"x"',
    "#H1F",
    "#15hello",
    "#0",
    "#",
    "#9999999999",
    "(@1)",
    "DBUV",
    "W",
    "VID",
    "LIN",
    "1,",
    ",1",
    "*",
    "ÿ",
]
_CONTROLS = [
    ";",
    ":",
    "?",
    " ",
    ",",
    "\n",
    "\r\n",
    "*",
    "&GTL\n",
    "*RST",
    "*CLS",
    "*OPC?",
    "INIT:CONT OFF",
    "INIT",
    "ABOR",
]
_TOKENS = st.one_of(
    st.sampled_from(_HEADERS),
    st.sampled_from(_HEADERS).map(lambda header: ":" + header + "?"),
    st.sampled_from(_DATA),
    st.sampled_from(_CONTROLS),
    st.text(alphabet="ABCDEFGHSTWY0123456789:;?*,' #\"", max_size=8),
)
_UNITS = st.tuples(st.sampled_from(_HEADERS), st.sampled_from(["", "?", " "]), st.sampled_from(["", *_DATA])).map(
    "".join
)


@given(tokens=st.lists(_TOKENS, max_size=25))
@settings(max_examples=EXAMPLES // 2, deadline=None, derandomize=True)
def test_token_soup_leaves_the_instrument_alive(tokens: list[str]) -> None:
    line = Line()
    line.send("".join(tokens).encode("latin-1"))
    line.assert_alive()


@given(units=st.lists(_UNITS, max_size=8))
@settings(max_examples=EXAMPLES // 5, deadline=None, derandomize=True)
def test_every_header_takes_every_datum(units: list[str]) -> None:
    line = Line()
    line.send((";:".join(units) + "\n").encode("latin-1"))
    line.assert_alive()


@given(data=st.binary(max_size=300), cuts=st.lists(st.integers(0, 300), max_size=5))
@settings(max_examples=EXAMPLES // 4, deadline=None, derandomize=True)
def test_messages_do_not_depend_on_how_the_bytes_arrive(data: bytes, cuts: list[int]) -> None:
    whole = MessageFramer().feed(data)
    framer = MessageFramer()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    assert [message for left, right in itertools.pairwise(edges) for message in framer.feed(data[left:right])] == whole


@given(chunks=st.lists(st.binary(max_size=50), max_size=40))
@settings(max_examples=EXAMPLES // 4, deadline=None, derandomize=True)
def test_framer_keeps_no_more_than_its_limit(chunks: list[bytes]) -> None:
    framer = MessageFramer(limit_bytes=64)
    for chunk in chunks:
        for message in framer.feed(chunk):
            assert len(message.body) <= 64
        assert framer.pending_bytes <= 64
