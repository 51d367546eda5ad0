"""The analyzer answers whatever it is asked."""

import itertools
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from analyzer_thread import AnalyzerThread, start_in_thread
from dialect_facts import FACTS
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scpi_bench import Bench, standing_instrument
from scpi_soup import KINDS
from wire_lines import HislipLine, RawLine

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.scpi.framing import MessageFramer
from service.frontend.drivers.scpi import (
    AnswerError,
    levels_of_block,
    levels_of_text,
    parse_date_time,
    parse_flag,
    parse_identity,
    parse_message,
    parse_number,
    split_answers,
    split_block,
)

EXAMPLES = examples(250)
NIGHTLY_EXAMPLES = 6_400
CASES = [
    pytest.param(name, kind, id=f"{name}-{kind}") for name, kind in itertools.product(sorted(DIALECTS), sorted(KINDS))
]


def throw(name, data):
    """Send bytes to a new instrument; fail unless it answers in lines and goes on answering."""
    bench = Bench(name)
    bench.instrument.settings.points = 101
    answers = bench.send(data)
    assert not bench.session.is_held, "nothing can be pending: every row is allowed"
    assert answers == b"" or answers.endswith(b"\n")
    bench.send(bench.framer.missing + b"\n")
    bench.send(b"\n")
    assert bench.framer.pending_bytes == 0
    assert bench.send(b"*IDN?\n") == DIALECTS[name].identity.encode() + b"\n"
    assert bench.instrument.status.error_count <= FACTS[name].queue_depths[1]


@pytest.mark.parametrize(
    ("examples", "is_repeatable"),
    [
        pytest.param(EXAMPLES, True, id="some"),
        pytest.param(NIGHTLY_EXAMPLES, False, id="many", marks=[pytest.mark.nightly, pytest.mark.timeout(3600)]),
    ],
)
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_anything_leaves_the_instrument_alive(name, kind, examples, is_repeatable):
    check = given(KINDS[kind](name))(lambda data: throw(name, data))
    options = settings(
        max_examples=examples,
        deadline=None,
        derandomize=is_repeatable,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no fault of the strategy
    )
    options(check)()


def framer_fed_in_pieces(data, cuts):
    """Return what a framer makes of bytes that arrive in pieces."""
    framer = MessageFramer()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [message for left, right in itertools.pairwise(edges) for message in framer.feed(data[left:right])]


@given(data=st.binary(max_size=300), cuts=st.lists(st.integers(0, 300), max_size=5))
@settings(max_examples=2 * EXAMPLES, deadline=None, derandomize=True)
def test_messages_do_not_depend_on_how_the_bytes_arrive(data, cuts):
    assert framer_fed_in_pieces(data, cuts) == MessageFramer().feed(data)


@given(chunks=st.lists(st.binary(max_size=50), max_size=40))
@settings(max_examples=2 * EXAMPLES, deadline=None, derandomize=True)
def test_framer_keeps_no_more_than_its_limit(chunks):
    framer = MessageFramer(limit_bytes=64)
    for chunk in chunks:
        for message in framer.feed(chunk):
            assert len(message.body) <= 64
        assert framer.pending_bytes <= 64


def _block(payload):
    size = str(len(payload)).encode()
    return b"#" + str(len(size)).encode() + size + payload


@given(payload=st.binary(max_size=80), tail=st.sampled_from([b"", b" ", b"\r"]))
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
def test_block_of_any_bytes_is_one_datum_of_one_message(payload, tail):
    bench = Bench("rs")
    assert bench.send(b"FREQ:CENT " + _block(payload) + tail + b"\n*ESE?\n") == b"0\n"
    assert bench.errors() == [-168]


PARSERS: list[Callable[[str], Any]] = [
    parse_identity,
    parse_message,
    parse_number,
    parse_flag,
    split_answers,
    lambda text: levels_of_text(text, 3),
    lambda text: parse_date_time(text, text),
]


@pytest.mark.parametrize("parse", PARSERS)
@given(text=st.one_of(st.text(max_size=60), st.from_regex(r'[-+0-9,;"#.eE ]{0,30}', fullmatch=True)))
def test_text_of_any_kind(parse, text):
    try:
        value = parse(text)
    except AnswerError:
        return
    assert value is not None


@given(st.one_of(st.binary(max_size=60), st.from_regex(rb"#[0-9(][0-9)]{0,4}[\x00-\xff]{0,20}", fullmatch=True)))
def test_blocks_of_any_kind(data):
    try:
        payload, rest = split_block(data)
    except AnswerError:
        return
    assert payload + rest in data + b"\n"


@given(st.lists(st.floats(min_value=-200, max_value=50, width=32), min_size=1, max_size=50), st.binary(max_size=8))
def test_a_real_block_comes_back(levels, tail):
    content = np.array(levels, dtype="<f4").tobytes()
    size = str(len(content)).encode()
    payload, rest = split_block(b"#" + str(len(size)).encode() + size + content + tail)
    assert rest == tail
    np.testing.assert_array_equal(levels_of_block(payload, len(levels)), np.array(levels))


@given(
    st.lists(st.text(alphabet='ab1,. "', max_size=8).filter(lambda t: t.count('"') % 2 == 0), min_size=1, max_size=6)
)
def test_answers_come_apart_where_they_were_joined(answers):
    assert split_answers(";".join(answers)) == [answer.strip() for answer in answers]


WIRE_EXAMPLES = examples(150)
NIGHTLY_WIRE_EXAMPLES = 1000
_NONCES = itertools.cycle(range(1, 128))


@pytest.fixture(params=sorted(DIALECTS))
def name(request):
    return str(request.param)


@pytest.fixture
def analyzer(name):
    dialect = DIALECTS[name]
    with start_in_thread(standing_instrument(dialect), dialect=dialect, hislip_port=0) as handle:
        yield handle


class SocketThrower:
    """Throws bytes at one connection for as long as it lives."""

    def __init__(self, analyzer, identity):
        self.line = RawLine(analyzer.port)
        self._identity = identity
        self._analyzer = analyzer
        #: knows what stands open, as a client knows that forgot a quote
        self._framer = MessageFramer()

    def throw(self, data):
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

    def __init__(self, analyzer, identity):
        self.line = HislipLine(analyzer.hislip_port or 0)
        self._identity = identity
        self._analyzer = analyzer

    def throw(self, data):
        """Send a message, clear the device, ask who is there."""
        self._analyzer.instrument.settings.points = 101
        self.line.write(data)
        self.line.clear()
        nonce = next(_NONCES)
        assert self.line.ask(f"*ESE {nonce};*IDN?;*ESE?") == f"{self._identity};{nonce}"


THROWERS: list[Callable[[AnalyzerThread, str], SocketThrower | HislipThrower]] = [SocketThrower, HislipThrower]


def fuzz_line(analyzer, name, make, examples):
    """Throw examples of all kinds at one line; the repeatable ones when they are few."""
    kinds = st.one_of(*(kind(name) for kind in KINDS.values()))
    thrower = make(analyzer, DIALECTS[name].identity)
    with closing(thrower.line):
        check = given(kinds)(thrower.throw)
        options = settings(
            max_examples=examples,
            deadline=None,
            derandomize=examples == WIRE_EXAMPLES,
            database=None,
            suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no fault of the strategy
        )
        options(check)()


@pytest.mark.system
@pytest.mark.parametrize("make", THROWERS)
def test_anything_leaves_the_line_alive(analyzer, name, make):
    fuzz_line(analyzer, name, make, WIRE_EXAMPLES)


@pytest.mark.system
@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("make", THROWERS)
def test_nightly_anything_leaves_the_line_alive(analyzer, name, make):
    fuzz_line(analyzer, name, make, NIGHTLY_WIRE_EXAMPLES)


@pytest.mark.system
def test_bytes_that_are_no_hislip_end_only_their_own_session(analyzer, name):
    neighbour = HislipLine(analyzer.hislip_port or 0)

    @given(data=st.binary(min_size=16, max_size=200), is_first=st.booleans())
    @settings(max_examples=WIRE_EXAMPLES, deadline=None, derandomize=True, database=None)
    def throw(data, is_first):
        line = RawLine(analyzer.hislip_port or 0) if is_first else HislipLine(analyzer.hislip_port or 0)
        (line if isinstance(line, RawLine) else line.sync).write(data)
        line.close()
        assert neighbour.ask("*IDN?") == DIALECTS[name].identity

    throw()
    neighbour.close()
