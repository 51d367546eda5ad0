"""What makes one maker's analyzer different from another's, as data."""

from dataclasses import dataclass

from analyzer_sim.command_row import Command


@dataclass(frozen=True, slots=True)
class Dialect:
    """One maker's language.

    A new dialect is a module with a table of rows and one ``Dialect``, entered in ``dialects.py``.
    """

    #: name on the command line
    name: str
    #: rows of this dialect beside the common commands
    commands: tuple[Command, ...]
    #: messages that the raw socket takes for the interface and the parser never sees
    interface_messages: frozenset[bytes] = frozenset()
    #: relative headers that miss their path are looked up from the root
    is_lenient: bool = False
