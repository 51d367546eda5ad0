"""Whatever a client sends, in any dialect: the simulated analyzer neither raises nor falls silent nor grows.

Counts: 4 dialects x 4 kinds x ``EXAMPLES`` in the process, the framer apart, and the same kinds over live sockets and
HiSLIP in ``test_scpi_never_dies_wire.py``. ``test_nightly_*`` repeat it with fresh examples, a hundred thousand in all.
"""

import itertools

import pytest
from dialect_facts import FACTS
from example_counts import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scpi_bench import Bench
from scpi_soup import KINDS

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.scpi.framing import MessageFramer

EXAMPLES = examples(250)
NIGHTLY_EXAMPLES = 6_400
CASES = [
    pytest.param(name, kind, id=f"{name}-{kind}") for name, kind in itertools.product(sorted(DIALECTS), sorted(KINDS))
]


def throw(name: str, data: bytes) -> None:
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


def fuzz(name: str, kind: str, examples: int, *, is_repeatable: bool) -> None:
    """Throw examples of one kind at one dialect."""
    check = given(KINDS[kind](name))(lambda data: throw(name, data))
    options = settings(
        max_examples=examples,
        deadline=None,
        derandomize=is_repeatable,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no fault of the strategy
    )
    options(check)()


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_anything_leaves_the_instrument_alive(name: str, kind: str) -> None:
    fuzz(name, kind, EXAMPLES, is_repeatable=True)


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_nightly_anything_leaves_the_instrument_alive(name: str, kind: str) -> None:
    fuzz(name, kind, NIGHTLY_EXAMPLES, is_repeatable=False)


def framer_fed_in_pieces(data: bytes, cuts: list[int]) -> list[object]:
    """Return what a framer makes of bytes that arrive in pieces."""
    framer = MessageFramer()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    return [message for left, right in itertools.pairwise(edges) for message in framer.feed(data[left:right])]


@given(data=st.binary(max_size=300), cuts=st.lists(st.integers(0, 300), max_size=5))
@settings(max_examples=2 * EXAMPLES, deadline=None, derandomize=True)
def test_messages_do_not_depend_on_how_the_bytes_arrive(data: bytes, cuts: list[int]) -> None:
    assert framer_fed_in_pieces(data, cuts) == MessageFramer().feed(data)


@given(chunks=st.lists(st.binary(max_size=50), max_size=40))
@settings(max_examples=2 * EXAMPLES, deadline=None, derandomize=True)
def test_framer_keeps_no_more_than_its_limit(chunks: list[bytes]) -> None:
    framer = MessageFramer(limit_bytes=64)
    for chunk in chunks:
        for message in framer.feed(chunk):
            assert len(message.body) <= 64
        assert framer.pending_bytes <= 64


def _block(payload: bytes) -> bytes:
    size = str(len(payload)).encode()
    return b"#" + str(len(size)).encode() + size + payload


@given(payload=st.binary(max_size=80), tail=st.sampled_from([b"", b" ", b"\r"]))
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
def test_block_of_any_bytes_is_one_datum_of_one_message(payload: bytes, tail: bytes) -> None:
    bench = Bench("rs")
    assert bench.send(b"FREQ:CENT " + _block(payload) + tail + b"\n*ESE?\n") == b"0\n"
    assert bench.errors() == [-168]
