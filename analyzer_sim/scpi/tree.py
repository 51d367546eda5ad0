"""Headers -> commands: a tree of mnemonics built from patterns, walked by the path rules of SCPI-99, 6.2.

A pattern is written as manuals write it: ``[SENSe<6>]:BANDwidth|BWIDth[:RESolution]:AUTO``. Upper case letters are the
short form, brackets mark optional nodes, bars alternatives, ``<n>`` the largest numeric suffix. A mnemonic matches in
its short or its long form, nothing between.

Path rules: a leading colon starts at the root; otherwise the mnemonics of the previous header of the same message,
without its last, are put in front; common commands neither use nor change the path.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from analyzer_sim.scpi.errors import ScpiError
from analyzer_sim.scpi.parser import Unit, short_form

T = TypeVar("T")

_PATTERN_NODE = re.compile(r"(\[)?:?([A-Za-z*_|]+)(?:<(\d+)>)?:?(\])?")


@dataclass(frozen=True, slots=True)
class PatternNode:
    """One node of a header pattern."""

    #: accepted spellings, upper case: short and long form of each alternative
    names: tuple[str, ...]
    #: largest numeric suffix; 0 = the node takes none
    suffix_limit: int
    is_optional: bool


@dataclass(slots=True)
class _Branch(Generic[T]):
    children: dict[str, "_Branch[T]"] = field(default_factory=dict)
    suffix_limit: int = 0
    command: T | None = None


def parse_pattern(pattern: str) -> tuple[PatternNode, ...]:
    """Read a header pattern.

    Examples
    --------
    >>> [(n.names, n.is_optional) for n in parse_pattern("[SENSe<6>]:FREQuency")]
    [(('SENS', 'SENSE'), True), (('FREQ', 'FREQUENCY'), False)]
    """
    nodes = []
    for found in _PATTERN_NODE.finditer(pattern):
        names: list[str] = []
        for name in found.group(2).split("|"):
            names += [short_form(name), name.upper()]
        nodes.append(PatternNode(tuple(dict.fromkeys(names)), int(found.group(3) or 0), found.group(1) is not None))
    return tuple(nodes)


class CommandTree(Generic[T]):
    """All commands of a dialect.

    Parameters
    ----------
    rows : iterable of (pattern, command)
        Two rows may not meet in one header.
    is_lenient : bool
        Look a relative header up from the root when the path does not lead to it, as some firmware does.
    """

    def __init__(self, rows: Iterable[tuple[str, T]], *, is_lenient: bool = False) -> None:
        self._root: _Branch[T] = _Branch()
        self._is_lenient = is_lenient
        for pattern, command in rows:
            self._insert(self._root, parse_pattern(pattern), command, pattern)

    def _insert(self, branch: _Branch[T], nodes: tuple[PatternNode, ...], command: T, pattern: str) -> None:
        """Add a row below ``branch``, once with and once without each optional node."""
        if not nodes:
            if branch.command is not None and branch.command is not command:
                raise ValueError(f"two commands for the header {pattern}")
            branch.command = command
            return
        node, rest = nodes[0], nodes[1:]
        if node.is_optional:
            self._insert(branch, rest, command, pattern)
        child = next((branch.children[name] for name in node.names if name in branch.children), _Branch[T]())
        child.suffix_limit = max(child.suffix_limit, node.suffix_limit)
        branch.children.update(dict.fromkeys(node.names, child))
        self._insert(child, rest, command, pattern)

    def find(self, unit: Unit, path: tuple[str, ...]) -> tuple[T, tuple[str, ...]]:
        """Return the command of a unit and the path the next unit starts from.

        Raises
        ------
        ScpiError
            -113 no such header, -114 a numeric suffix is out of range.
        """
        if unit.is_common:
            return self._walk(unit.nodes, unit), path
        prefix = () if unit.is_absolute else path
        try:
            command = self._walk(prefix + unit.nodes, unit)
        except ScpiError:
            if not (self._is_lenient and prefix):
                raise
            prefix = ()
            command = self._walk(unit.nodes, unit)
        return command, (prefix + unit.nodes)[:-1]

    def _walk(self, nodes: tuple[str, ...], unit: Unit) -> T:
        branch = self._root
        for mnemonic in nodes:
            branch = _descend(branch, mnemonic, unit)
        if branch.command is None:
            raise ScpiError(-113, unit.header)
        return branch.command


def _descend(branch: _Branch[T], mnemonic: str, unit: Unit) -> _Branch[T]:
    name = mnemonic.rstrip("0123456789")
    suffix = mnemonic[len(name) :]
    child = branch.children.get(name)
    if child is None or (suffix and not child.suffix_limit):
        raise ScpiError(-113, unit.header)
    if not suffix:
        return child
    if len(suffix) > 4 or not 1 <= int(suffix) <= child.suffix_limit:
        raise ScpiError(-114, unit.header)
    return child
