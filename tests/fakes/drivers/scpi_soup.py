"""Messages for fuzzing a dialect: bytes, message units of the grammar, and spoiled spellings of its real headers."""

from functools import cache

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer_sim.dialects.dialects import DIALECTS
from analyzer_sim.scpi.tree import parse_pattern

#: one example must not cost a second: no sweeps of a hundred thousand points, no thousand sweeps to a trace
COSTLY = ("POIN", "COUN")

# fmt: off
DATA = [
    "1", "-1", "1e3", "30kHz", "1 GHZ", "1e99", "1e40000", "0", "0.5", "MIN", "MAX", "DEF", "UP", "DOWN", "INF", "NINF",
    "ON", "OFF", "RMS", "POS", "NEG", "SAMP", "AVER", "APE", "NORM", "FFT", "SWE", "REAL", "ASC", "INT", "32", "64",
    "REAL,32", "REAL,64", "INT,32", "SWAP", "TRACE1", "TRACE2", "1,1", "CPOW", "CHP", "POW", "'SAN'", "'",
    '"x"', "#H1F", "#15hello", "#0", "#", "#9999999999", "(@1)", "DBUV", "W", "VID", "LIN", "LOG", "1,", ",1", "*",
    "ÿ", "50PCT", "99 PCT", "-50 DBM", "10 DB",
]
CONTROLS = [
    ";", ":", "?", " ", ",", "\n", "\r\n", "*", "&GTL\n", "*RST", "*CLS", "*OPC?", "*WAI", "*TRG", "INIT:CONT OFF",
    "INIT", "ABOR", "SYST:ERR?", "*STB?",
]
# fmt: on


@cache
def spellings(name: str) -> tuple[str, ...]:
    """Return a short and a long spelling of every header of a dialect, suffixes left out."""
    headers = set()
    for row in DIALECTS[name].commands:
        nodes = parse_pattern(row.pattern)
        headers.add(":".join(node.names[0] for node in nodes if not node.is_optional))
        headers.add(":".join(node.names[-1] for node in nodes))
    return tuple(sorted(header for header in headers if not any(word in header for word in COSTLY)))


#: what is at a place, and as wide, is replaced by something
_EDITS = st.tuples(
    st.floats(0.0, 1.0),
    st.integers(0, 3),
    st.one_of(st.just(""), st.text(alphabet="AEINST0189:;?*,' #\"\n\x00é", max_size=3), st.sampled_from(DATA)),
)


def units(name: str) -> SearchStrategy[str]:
    """Return message units with real headers and any datum."""
    parts = st.tuples(
        st.sampled_from(spellings(name)), st.sampled_from(["", "?", " ", "? "]), st.sampled_from(["", *DATA])
    )
    return parts.map("".join)


def _messages(name: str) -> SearchStrategy[bytes]:
    return st.lists(units(name), max_size=6).map(lambda texts: _encoded(";:".join(texts) + "\n"))


def _mutations(name: str) -> SearchStrategy[bytes]:
    def spoil(texts: list[str], edits: list[tuple[float, int, str]]) -> bytes:
        message = ";:".join(texts)
        for position, width, text in edits:
            at = int(position * len(message))
            message = message[:at] + text + message[at + width :]
        return _encoded(message + "\n")

    return st.builds(spoil, st.lists(units(name), min_size=1, max_size=3), st.lists(_EDITS, min_size=1, max_size=5))


def _soup(name: str) -> SearchStrategy[bytes]:
    headers = st.sampled_from(spellings(name))
    tokens = st.one_of(
        headers,
        headers.map(lambda header: ":" + header + "?"),
        st.sampled_from(DATA),
        st.sampled_from(CONTROLS),
        st.text(alphabet="ABCDEFGHSTWY0123456789:;?*,' #\"", max_size=8),
    )
    return st.lists(tokens, max_size=25).map(lambda texts: _encoded("".join(texts)))


def _encoded(text: str) -> bytes:
    return text.encode("latin-1", "replace")


def bytes_of_any_kind(_name: str) -> SearchStrategy[bytes]:
    """Return bytes without sense."""
    return st.lists(st.binary(max_size=60), max_size=6).map(b"".join)


#: what is thrown at every dialect
KINDS = {"bytes": bytes_of_any_kind, "messages": _messages, "mutations": _mutations, "soup": _soup}
