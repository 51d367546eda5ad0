"""Log lines: one event a line, as JSON or as text, each naming the request it belongs to.

Control characters never reach a line as they are, so nobody who sends a request can write lines of his own. Whatever
looks like a bearer key, or like the password of an address, is left out of every line, tracebacks included.
"""

import json
import logging
import re
import sys
from contextvars import ContextVar
from typing import Any, Literal, TextIO

from service.records.epoch import US_PER_S, format_epoch
from service.records.operations import access

#: id of the request in progress; empty outside of requests
REQUEST_ID: ContextVar[str] = ContextVar("request_id", default="")
#: forms of lines
LogForm = Literal["json", "text"]

_SECRETS = re.compile(r"(?i)(?<=\bbearer )\s*\S+|(?<=://)[^\s/@:]*:[^\s/@]*(?=@)")
_CONTROLS = {code: f"\\u{code:04x}" for code in (*range(32), 127, *range(0x80, 0xA0), 0x2028, 0x2029)}
_HIDDEN = "[hidden]"


class JsonLogFormatter(logging.Formatter):
    """One JSON object a line: ``time``, ``level``, ``logger``, ``message``, ``request_id``, fields, ``traceback``.

    Fields of an event are given as ``extra={"fields": {...}}``.

    Examples
    --------
    >>> record = logging.makeLogRecord({"msg": "ready", "levelname": "INFO", "name": "soo", "created": 0.0})
    >>> JsonLogFormatter().format(record)
    '{"time":"1970-01-01T00:00:00.000000Z","level":"info","logger":"soo","message":"ready"}'
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of an event."""
        reported: dict[str, Any] = {
            "time": _time_of(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": without_secrets(record.getMessage()),
        }
        if request_id := REQUEST_ID.get():
            reported["request_id"] = request_id
        for name, value in _fields_of(record).items():
            reported[name] = without_secrets(value) if isinstance(value, str) else value
        if record.exc_info:
            reported["traceback"] = without_secrets(self.formatException(record.exc_info))
        return json.dumps(reported, ensure_ascii=False, separators=(",", ":"), default=str).translate(_CONTROLS)


class TextLines(logging.Formatter):
    """One line of text an event, for people; a traceback follows on lines of its own.

    Examples
    --------
    >>> fields = {"status": 200}
    >>> record = logging.makeLogRecord({"msg": "GET", "levelname": "INFO", "name": "soo", "created": 0.0})
    >>> record.fields = fields
    >>> TextLines().format(record)
    '1970-01-01T00:00:00.000000Z INFO soo GET status=200'
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of an event."""
        fields = dict(_fields_of(record))
        if request_id := REQUEST_ID.get():
            fields["request_id"] = request_id
        words = [_time_of(record), record.levelname, record.name, record.getMessage()]
        line = " ".join((*words, *(f"{name}={value}" for name, value in fields.items())))
        line = without_secrets(line).translate(_CONTROLS)
        if record.exc_info:
            line += "\n" + without_secrets(self.formatException(record.exc_info))
        return line


FORMS: dict[LogForm, type[logging.Formatter]] = {"json": JsonLogFormatter, "text": TextLines}


def without_secrets(text: str) -> str:
    """Return a text without bearer keys and passwords of addresses.

    Examples
    --------
    >>> without_secrets("postgresql://soo:secret@host/soo said no to Bearer abc")
    'postgresql://[hidden]@host/soo said no to Bearer [hidden]'
    """
    return access.without_secrets(_SECRETS.sub(_HIDDEN, text))


def write_log(level: str, form: LogForm, stream: TextIO | None = None) -> None:
    """Make every logger of the process write lines of one form to a stream, by default standard error."""
    handler = logging.StreamHandler(sys.stderr if stream is None else stream)
    handler.setFormatter(FORMS[form]())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    logging.captureWarnings(capture=True)
    # one line a request is written by the interface itself; the client's library tells its own at every call
    for name in ("uvicorn.access", "httpx", "httpcore"):
        logging.getLogger(name).setLevel(logging.WARNING)


def _time_of(record: logging.LogRecord) -> str:
    """Return when an event happened."""
    return format_epoch(round(record.created * US_PER_S))


def _fields_of(record: logging.LogRecord) -> dict[str, Any]:
    fields = getattr(record, "fields", None)
    return fields if isinstance(fields, dict) else {}
