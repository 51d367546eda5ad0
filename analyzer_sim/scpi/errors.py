"""The error numbers of SCPI-99 that the instrument can queue, with their texts and classes.

Law of this file: a number that may stand in the error queue stands in ``ERROR_TEXTS``; its hundreds decide the bit of
the standard event register. Nothing here knows which command failed.
"""

ERROR_TEXTS: dict[int, str] = {
    0: "No error",
    -100: "Command error",
    -101: "Invalid character",
    -102: "Syntax error",
    -103: "Invalid separator",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -114: "Header suffix out of range",
    -120: "Numeric data error",
    -121: "Invalid character in number",
    -123: "Exponent too large",
    -124: "Too many digits",
    -128: "Numeric data not allowed",
    -131: "Invalid suffix",
    -138: "Suffix not allowed",
    -141: "Invalid character data",
    -144: "Character data too long",
    -148: "Character data not allowed",
    -151: "Invalid string data",
    -158: "String data not allowed",
    -161: "Invalid block data",
    -168: "Block data not allowed",
    -200: "Execution error",
    -203: "Command protected",
    -211: "Trigger ignored",
    -213: "Init ignored",
    -221: "Settings conflict",
    -222: "Data out of range",
    -223: "Too much data",
    -224: "Illegal parameter value",
    -230: "Data corrupt or stale",
    -300: "Device-specific error",
    -310: "System error",
    -350: "Queue overflow",
    -400: "Query error",
    -410: "Query INTERRUPTED",
    -420: "Query UNTERMINATED",
    -430: "Query DEADLOCKED",
    -440: "Query UNTERMINATED after indefinite response",
}

#: characters of a detail that are kept
DETAIL_LIMIT = 120

#: bit of the standard event register set by each class of errors (IEEE 488.2, 11.5.1.1)
EVENT_BIT_OF_HUNDREDS: dict[int, int] = {1: 5, 2: 4, 3: 3, 4: 2}


class ScpiError(Exception):
    """A program message unit failed; it is queued, never answered.

    Parameters
    ----------
    code : int
        A key of ``ERROR_TEXTS``.
    detail : str
        What was wrong, for the person who reads the queue; no line break.
    """

    def __init__(self, code: int, detail: str = "") -> None:
        super().__init__(code, detail[:DETAIL_LIMIT])
        self.code = code
        self.detail = detail[:DETAIL_LIMIT]


def event_bit(code: int) -> int:
    """Return the bit number of the standard event register that an error sets.

    Examples
    --------
    >>> event_bit(-113), event_bit(-222)
    (5, 4)
    """
    return EVENT_BIT_OF_HUNDREDS[-code // 100]


def error_entry(code: int, detail: str = "") -> str:
    """Return the line a query of the error queue answers.

    Double quotes of the detail become single ones, so that the line stays one string of SCPI.

    Examples
    --------
    >>> error_entry(-113, "FREQ:CNT")
    '-113,"Undefined header;FREQ:CNT"'
    """
    text = ERROR_TEXTS[code]
    if detail:
        printable = "".join(c if " " <= c <= "~" else "." for c in detail).replace('"', "'")
        text = f"{text};{printable}"
    return f'{code},"{text}"'
