"""Status model of IEEE 488.2 and SCPI-99: registers, summary bits and the error queue. No command, no socket.

Law of this file: everything that changes a status bit is here. The summary is computed when asked, never stored::

    status byte  bit 2  error queue holds something          bit 5  standard event register & its enable
                 bit 3  QUEStionable event & enable          bit 6  (any other bit & service request enable) = MSS
                 bit 4  a response waits in this session     bit 7  OPERation event & enable

    standard     bit 0 operation complete   bit 3 device error      bit 5 command error
    event        bit 2 query error          bit 4 execution error   bit 7 power on
"""

from collections import deque

from analyzer_sim.scpi.errors import error_entry, event_bit

ESR_OPERATION_COMPLETE = 1 << 0
ESR_POWER_ON = 1 << 7

#: OPERation:CONDition, a sweep is running (SCPI-99, 9.3)
OPERATION_SWEEPING = 1 << 3
#: OPERation:CONDition, the instrument waits for a trigger; here: for the ground to allow the next row
OPERATION_WAITING_FOR_TRIGGER = 1 << 5
#: QUEStionable:CONDition, the power is outside the range of the input
QUESTIONABLE_POWER = 1 << 3
#: QUEStionable:INTegrity:CONDition, a sweep faster than the filter settles
INTEGRITY_UNCALIBRATED = 1 << 3

#: bits of a SCPI register that are used; bit 15 is always zero
REGISTER_MASK = 0x7FFF


class StatusRegister:
    """One SCPI status register: condition, event, enable and the filters of edges, 15 bits each.

    An edge is latched in the event part when its filter lets it through; after a preset that is every rising one.
    """

    def __init__(self) -> None:
        self.condition = 0
        self.event = 0
        self.enable = 0
        self.rising = REGISTER_MASK
        self.falling = 0

    def put_condition(self, bits: int) -> None:
        """Replace the condition; edges that their filter lets through are latched in the event part."""
        risen, fallen = bits & ~self.condition, self.condition & ~bits
        self.event |= (risen & self.rising | fallen & self.falling) & REGISTER_MASK
        self.condition = bits & REGISTER_MASK

    def put_bit(self, bit: int, *, is_set: bool) -> None:
        """Set or clear one bit of the condition."""
        self.put_condition(self.condition | bit if is_set else self.condition & ~bit)

    def preset(self) -> None:
        """Report nothing; let rising edges through."""
        self.enable, self.rising, self.falling = 0, REGISTER_MASK, 0

    def pop_event(self) -> int:
        """Return the event part and clear it."""
        event, self.event = self.event, 0
        return event

    @property
    def summary(self) -> bool:
        """Return whether an enabled event is latched."""
        return bool(self.event & self.enable)


class ErrorQueue:
    """First in, first out; when it is full its last entry becomes -350.

    Parameters
    ----------
    depth : int
        Entries it holds.
    no_error : str
        What an empty queue answers.
    """

    def __init__(self, depth: int, no_error: str) -> None:
        self._depth = depth
        self._no_error = no_error
        self._entries: deque[tuple[int, str]] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    def push(self, code: int, detail: str = "") -> bool:
        """Put an error at the end; return whether there was room for it."""
        if len(self._entries) < self._depth:
            self._entries.append((code, detail))
            return True
        self._entries[-1] = (-350, "")
        return False

    def pop(self) -> str:
        """Take the oldest error out."""
        return error_entry(*self._entries.popleft()) if self._entries else self._no_error

    def clear(self) -> None:
        """Empty the queue."""
        self._entries.clear()


class StatusModel:
    """The whole status of one instrument.

    Parameters
    ----------
    error_queue_depth : int
        Entries the error queue holds.
    no_error : str
        What an empty error queue answers.
    """

    def __init__(self, error_queue_depth: int = 30, no_error: str = '0,"No error"') -> None:
        self.operation = StatusRegister()
        self.questionable = StatusRegister()
        self.questionable_power = StatusRegister()
        self.questionable_integrity = StatusRegister()
        self.event = ESR_POWER_ON
        self.event_enable = 0
        self.service_enable = 0
        self._queue_state = error_queue_depth, no_error
        #: the queue in use; a dialect with a queue for each session puts that of the session here
        self.errors = self.new_queue()

    def new_queue(self) -> ErrorQueue:
        """Return an empty error queue of this instrument's kind."""
        return ErrorQueue(*self._queue_state)

    @property
    def _registers(self) -> tuple[StatusRegister, ...]:
        return self.operation, self.questionable, self.questionable_power, self.questionable_integrity

    def push_error(self, code: int, detail: str = "") -> None:
        """Queue an error and set its event bit; when the queue is full its last entry becomes -350."""
        self.event |= 1 << event_bit(code)
        if not self.errors.push(code, detail):
            self.event |= 1 << event_bit(-350)

    def pop_error(self) -> str:
        """Take the oldest error out; the text for "no error" when there is none."""
        return self.errors.pop()

    def pop_all_errors(self) -> str:
        """Take all errors out, joined by commas."""
        entries = [self.pop_error() for _ in range(max(1, len(self.errors)))]
        return ",".join(entries)

    @property
    def error_count(self) -> int:
        """Errors in the queue."""
        return len(self.errors)

    def pop_event(self) -> int:
        """Return the standard event register and clear it."""
        event, self.event = self.event, 0
        return event

    def put_questionable_power(self, bits: int) -> None:
        """Replace the overload bits; their sum is the POWer bit of QUEStionable."""
        self.questionable_power.put_condition(bits)
        self.questionable.put_bit(QUESTIONABLE_POWER, is_set=bits != 0)

    def put_uncalibrated(self, bit: int, *, is_set: bool) -> None:
        """Tell whether the sweep shown was too fast: in this bit of QUEStionable and in INTegrity."""
        self.questionable_integrity.put_bit(INTEGRITY_UNCALIBRATED, is_set=is_set)
        self.questionable.put_bit(1 << bit, is_set=is_set)

    def status_byte(self, *, has_response: bool) -> int:
        """Return the status byte; bit 6 is the master summary."""
        byte = (
            bool(self.errors) << 2
            | self.questionable.summary << 3
            | has_response << 4
            | bool(self.event & self.event_enable) << 5
            | self.operation.summary << 7
        )
        return byte | bool(byte & self.service_enable) << 6

    def clear(self) -> None:
        """``*CLS``: empty the event registers and the error queue; enables stay."""
        self.errors.clear()
        self.event = 0
        for register in self._registers:
            register.event = 0

    def preset(self) -> None:
        """``STATus:PRESet``: disable the reporting of both SCPI registers."""
        for register in self._registers:
            register.preset()
