"""Status model of IEEE 488.2 and SCPI-99: registers, summary bits and the error queue. No command, no socket.

Law of this file: everything that changes a status bit is here. The summary is computed when asked, never stored::

    status byte  bit 2  error queue holds something          bit 5  standard event register & its enable
                 bit 3  QUEStionable event & enable          bit 6  (any other bit & service request enable) = MSS
                 bit 4  a response waits in this session     bit 7  OPERation event & enable

    standard     bit 0 operation complete   bit 3 device error      bit 5 command error
    event        bit 2 query error          bit 4 execution error   bit 7 power on
"""

from collections import deque

from analyzer_sim.scpi_errors import error_entry, event_bit

#: depth of the error queue; R&S keeps 30 and more, 20 is the least SCPI instruments have
ERROR_QUEUE_DEPTH = 30

ESR_OPERATION_COMPLETE = 1 << 0
ESR_POWER_ON = 1 << 7

#: OPERation:CONDition, a sweep is running (SCPI-99, 9.3)
OPERATION_SWEEPING = 1 << 3
#: OPERation:CONDition, the instrument waits for a trigger; here: for the ground to allow the next row
OPERATION_WAITING_FOR_TRIGGER = 1 << 5
#: QUEStionable:CONDition, the power is outside the range of the input
QUESTIONABLE_POWER = 1 << 3
#: QUEStionable:CONDition, the trace is not calibrated: swept faster than the filter settles
QUESTIONABLE_CALIBRATION = 1 << 8

_REGISTER_MASK = 0x7FFF


class StatusRegister:
    """One SCPI status register: condition, event (rising edges) and enable, 15 bits each."""

    def __init__(self) -> None:
        self.condition = 0
        self.event = 0
        self.enable = 0

    def put_condition(self, bits: int) -> None:
        """Replace the condition; bits that rise are latched in the event part."""
        self.event |= bits & ~self.condition & _REGISTER_MASK
        self.condition = bits & _REGISTER_MASK

    def put_bit(self, bit: int, *, is_set: bool) -> None:
        """Set or clear one bit of the condition."""
        self.put_condition(self.condition | bit if is_set else self.condition & ~bit)

    def put_enable(self, bits: int) -> None:
        """Replace the enable mask; bit 15 is always zero."""
        self.enable = bits & _REGISTER_MASK

    def take_event(self) -> int:
        """Return the event part and clear it."""
        event, self.event = self.event, 0
        return event

    @property
    def summary(self) -> bool:
        """Whether an enabled event is latched."""
        return bool(self.event & self.enable)


class StatusModel:
    """The whole status of one instrument."""

    def __init__(self) -> None:
        self.operation = StatusRegister()
        self.questionable = StatusRegister()
        self.questionable_power = StatusRegister()
        self.event = ESR_POWER_ON
        self.event_enable = 0
        self.service_enable = 0
        self._errors: deque[tuple[int, str]] = deque()

    def push_error(self, code: int, detail: str = "") -> None:
        """Queue an error and set its event bit; when the queue is full its last entry becomes -350."""
        self.event |= 1 << event_bit(code)
        if len(self._errors) < ERROR_QUEUE_DEPTH:
            self._errors.append((code, detail))
            return
        self._errors[-1] = (-350, "")
        self.event |= 1 << event_bit(-350)

    def pop_error(self) -> str:
        """Take the oldest error out; ``0,"No error"`` when there is none."""
        return error_entry(*self._errors.popleft()) if self._errors else error_entry(0)

    def pop_all_errors(self) -> str:
        """Take all errors out, joined by commas."""
        entries = [self.pop_error() for _ in range(max(1, len(self._errors)))]
        return ",".join(entries)

    @property
    def error_count(self) -> int:
        """Errors in the queue."""
        return len(self._errors)

    def take_event(self) -> int:
        """Return the standard event register and clear it."""
        event, self.event = self.event, 0
        return event

    def put_questionable_power(self, bits: int) -> None:
        """Replace the overload bits; their sum is the POWer bit of QUEStionable."""
        self.questionable_power.put_condition(bits)
        self.questionable.put_bit(QUESTIONABLE_POWER, is_set=bits != 0)

    def status_byte(self, *, has_response: bool) -> int:
        """Return the status byte; bit 6 is the master summary."""
        byte = (
            bool(self._errors) << 2
            | self.questionable.summary << 3
            | has_response << 4
            | bool(self.event & self.event_enable) << 5
            | self.operation.summary << 7
        )
        return byte | bool(byte & self.service_enable) << 6

    def clear(self) -> None:
        """``*CLS``: empty the event registers and the error queue; enables stay."""
        self._errors.clear()
        self.event = 0
        for register in (self.operation, self.questionable, self.questionable_power):
            register.event = 0

    def preset(self) -> None:
        """``STATus:PRESet``: disable the reporting of both SCPI registers."""
        for register in (self.operation, self.questionable, self.questionable_power):
            register.enable = 0
