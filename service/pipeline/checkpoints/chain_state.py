"""State of a chain between two rows: all on which the next row depends beside the knowledge of slow inputs."""

import hashlib
from typing import NamedTuple

from service.pipeline.checkpoints.state_codec import Layout
from service.pipeline.config import ChainConfig
from service.pipeline.control.command.schedule_check import PanelSwing
from service.pipeline.estimation.method_disagreement import Disagreement
from service.pipeline.estimation.paper.runner import SavedPaper
from service.pipeline.estimation.robust.saved_state import SavedRobust
from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.measurement import Measurement

#: raised when the state means something else than before, though its classes look alike; their names, fields and types
#: are compared by themselves
LAYOUT_NUMBER = 2


class ChainState(NamedTuple):
    """State of a chain that runs."""

    alignment_id: int
    robust: SavedRobust | None
    paper: SavedPaper | None
    #: torque that wheels have not been given yet
    carry_n_m_s: FloatArray
    swing: PanelSwing | None
    newest_us: int | None
    recent_us: IntArray
    disagreement: Disagreement
    #: newest row, and whether anything was computed from it
    last: tuple[Measurement, bool] | None


_LAYOUT = Layout(ChainState)


def fingerprint(config: ChainConfig) -> str:
    """Return what a checkpoint must share with the program that restores it: layout, kernels and configuration."""
    settings = hashlib.sha256(repr(config).encode()).hexdigest()[:16]
    return f"{LAYOUT_NUMBER}/{_LAYOUT.digest}/{config.kernels}/{settings}"


def pack_state(state: ChainState) -> bytes:
    """Return a state as bytes."""
    return _LAYOUT.pack(state)


def unpack_state(content: bytes) -> ChainState:
    """Return the state of `pack_state`.

    Raises
    ------
    ValueError, KeyError, TypeError, OSError
        The bytes are not those of a state of this layout.
    """
    return _LAYOUT.unpack(content, ChainState)
