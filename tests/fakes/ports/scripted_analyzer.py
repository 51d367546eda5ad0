"""An analyzer of eleven points (Siglent: 751) without a line: it keeps settings and answers as one family does."""

from collections.abc import Callable

import numpy as np

#: settings that every analyzer has, and their values after a reset
BASE = {
    ":FREQ:STAR": "0",
    ":FREQ:STOP": "26.5E9",
    ":BAND": "3E6",
    ":BAND:VID": "3E6",
    ":SWE:TIME": "0.1",
    ":INIT:CONT": "1",
}
#: what the families have beside them
FAMILIES: dict[str, dict[str, str]] = {
    "rs": {
        ":INST": "SAN",
        ":SWE:POIN": "1001",
        ":SWE:TYPE": "AUTO",
        ":SWE:COUN": "0",
        ":UNIT:POW": "DBM",
        ":DET": "APE",
        ":DISP:TRAC:MODE": "WRIT",
        ":BAND:TYPE": "NORM",
        ":DISP:TRAC:Y:RLEV": "0",
        ":INP:ATT": "10",
        ":INP:GAIN:STAT": "0",
        ":FORM": "ASC,0",
    },
    "keysight": {
        ":INST": "SA",
        ":SWE:POIN": "1001",
        ":SWE:TYPE": "SWE",
        ":UNIT:POW": "DBM",
        ":DET:TRAC": "NORM",
        ":AVER:TYPE": "LOG",
        ":TRAC:TYPE": "WRIT",
        ":BAND:TYPE": "DB3",
        ":DISP:WIND:TRAC:Y:RLEV": "0",
        ":POW:ATT": "10",
        ":POW:GAIN": "0",
        ":FORM": "ASC,8",
        ":FORM:BORD": "NORM",
    },
    "siglent": {
        ":UNIT:POW": "DBM",
        ":DET:TRAC1": "POS",
        ":AVER:TYPE": "LOGP",
        ":TRAC1:MODE": "WRIT",
        ":SWE:MODE": "AUTO",
        ":DISP:WIND:TRAC:Y:RLEV": "0",
        ":POW:ATT": "20",
        ":POW:GAIN": "0",
        ":FORM": "ASC",
    },
    "anritsu": {
        ":DISP:POIN": "551",
        ":UNIT:POW": "DBM",
        ":DET": "POS",
        ":TRAC1:TYPE": "NORM",
        ":DISP:WIND:TRAC:Y:SCAL:RLEV": "0",
        ":POW:RF:ATT": "20",
        ":POW:RF:GAIN:STAT": "0",
        ":FORM": "ASC",
    },
}


class ScriptedSession:
    """Session to an analyzer of one family.

    Parameters
    ----------
    family : str
        One of `FAMILIES`.
    identity : str
        Answer to ``*IDN?``.
    """

    resource = "TCPIP::analyzer::5025::SOCKET"

    def __init__(self, family: str = "rs", identity: str = "Rohde&Schwarz,FSW-26,1,5") -> None:
        self.identity = identity
        self.reported: list[str] = []
        self.queue: list[str] = []
        self.family = family
        self.values = BASE | FAMILIES[family]
        #: setting -> the value it stays at whatever it is told
        self.stuck: dict[str, str] = {}
        self.known = {":STAT:QUES:COND?": "0", ":SIM:EPOCH?": "2026-11-21T03:02:32.011250Z"}
        self.levels = np.linspace(-90.0, -80.0, 751 if family == "siglent" else 11)
        self.is_closed = False
        self.timeouts: list[float | None] = []
        #: a block of the levels; None: the family's own byte order
        self.as_real: Callable[[np.ndarray], bytes] | None = None
        #: answers that no setting gives
        self.answer: Callable[[str], str | None] = lambda _: None
        #: what happens when a sweep ends
        self.after_sweep: Callable[[], None] = lambda: None

    def close(self) -> None:
        self.is_closed = True

    def write(self, message: str) -> None:
        self.reported.append(message)
        for unit in message.split(";"):
            self._set(unit)

    def _set(self, unit: str) -> None:
        header, _, value = unit.partition(" ")
        if header.startswith("*") or header in {":INIT", ":SYST:LOC", ":SWE:TIME:AUTO"}:
            return
        if header not in self.values:
            self.queue.append('-113,"Undefined header"')
        else:
            self.values[header] = self.stuck.get(header, {"ON": "1", "OFF": "0"}.get(value, value))

    def query(self, message: str, timeout_s: float | None = None) -> str:
        self.reported.append(message)
        self.timeouts.append(timeout_s)
        if message == "*IDN?":
            return self.identity
        return ";".join(self._answers(message))

    def await_answer(self, message: str, timeout_s: float, grace_s: float) -> str:
        assert grace_s <= timeout_s
        answer = self.query(message, timeout_s)
        self.after_sweep()
        return answer

    def query_block(self, message: str, timeout_s: float | None = None) -> tuple[bytes | None, str]:
        self.reported.append(message)
        _, _, further = message.partition(";")
        rest = "".join(f";{answer}" for answer in self._answers(further)) if further else ""
        text = ",".join(f"{level:.6E}" for level in self.levels)
        if self.values[":FORM"].startswith("REAL"):
            make = self.as_real or (lambda levels: levels.astype(self._byte_order).tobytes())
            return make(self.levels), rest
        if self.family == "anritsu":
            return text.encode(), rest
        return None, text + ("," if self.family == "siglent" else "") + rest

    @property
    def _byte_order(self) -> str:
        return ">f4" if self.values.get(":FORM:BORD") == "NORM" else "<f4"

    def _answers(self, message: str) -> list[str]:
        answers = []
        for unit in message.split(";"):
            header = unit if unit.startswith((":", "*")) else f":{unit}"
            if header == ":INIT":
                continue
            if (said := self.answer(header)) is not None:
                answers.append(said)
            elif header == "*IDN?":
                answers.append(self.identity)
            elif header == "*OPC?":
                answers.append("1")
            elif header == ":SYST:ERR?":
                answers.append(self.queue.pop(0) if self.queue else '0,"No error"')
            elif header in self.known:
                answers.append(self.known[header])
            elif header.rstrip("?") in self.values:
                answers.append(self.values[header.rstrip("?")])
            else:
                self.queue.append('-113,"Undefined header"')
                break
        return answers
