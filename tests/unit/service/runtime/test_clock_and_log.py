"""Clocks of real and simulated spacecraft, and lines of the log."""

import io
import json
import logging
import sys
import time

import pytest

from service.runtime.clock import DataClock, SystemClock, system_now_us
from service.runtime.log_format import REQUEST_ID, JsonLogFormatter, TextLines, write_log


def test_the_system_clock_is_utc_in_microseconds_for_everybody():
    clock = SystemClock()
    before = time.time_ns() // 1000
    found = [clock.now_us("a"), clock.system_us(), system_now_us()]
    after = time.time_ns() // 1000
    assert all(before <= now_us <= after for now_us in found)
    assert not clock.is_data("a")


@pytest.mark.parametrize("newest_us", [None, 17])
def test_the_data_clock_is_the_newest_epoch_of_a_simulated_spacecraft(newest_us):
    clock = DataClock({"simulated": True, "real": False}.__getitem__, {"simulated": newest_us}.get)
    assert clock.now_us("simulated") == newest_us
    assert clock.is_data("simulated")
    assert not clock.is_data("real")
    assert abs(clock.now_us("real") - clock.system_us()) < 10_000_000  # the same clock, read within ten seconds


def record(message: str, *args: object, fields: dict | None = None, exc_info=None) -> logging.LogRecord:
    """Return an event at the beginning of time."""
    made = logging.LogRecord("soo.test", logging.WARNING, "file.py", 1, message, args, exc_info)
    made.created = 1.5
    if fields is not None:
        made.fields = fields
    return made


def fault() -> tuple:
    """Return what an exception leaves behind."""
    try:
        int("no\nluck with Bearer abc")
    except ValueError:
        return sys.exc_info()
    raise AssertionError


def test_a_line_holds_what_is_known():
    token = REQUEST_ID.set("r-1")
    try:
        line = JsonLogFormatter().format(record("%d rows", 3, fields={"status": 200, "route": "/x"}))
    finally:
        REQUEST_ID.reset(token)
    assert json.loads(line) == {
        "time": "1970-01-01T00:00:01.500000Z",
        "level": "warning",
        "logger": "soo.test",
        "message": "3 rows",
        "request_id": "r-1",
        "status": 200,
        "route": "/x",
    }


@pytest.mark.parametrize("form", [JsonLogFormatter, TextLines])
def test_nobody_writes_lines_of_his_own(form):
    line = form().format(record("a\nb\r\x1b[31m\u2028\x85\x7f", fields={"path": "/x\n{}"}))
    assert not [c for c in line if ord(c) < 32 or c in "\u2028\x85\x7f"]
    if form is JsonLogFormatter:
        assert json.loads(line)["message"] == "a\nb\r\x1b[31m\u2028\x85\x7f"


def test_a_traceback_stays_on_the_line_in_json_and_follows_it_in_text():
    line = JsonLogFormatter().format(record("failed", exc_info=fault()))
    assert "\n" not in line
    assert "ValueError" in json.loads(line)["traceback"]
    assert len(TextLines().format(record("failed", exc_info=fault())).splitlines()) > 2


@pytest.mark.parametrize("form", [JsonLogFormatter, TextLines])
@pytest.mark.parametrize(
    "text",
    [
        "Authorization: Bearer swordfish",
        "bearer  swordfish",
        "postgresql+psycopg://soo:swordfish@db.example/soo is away",
    ],
)
def test_secrets_are_left_out(form, text):
    reported = form().format(record("%s", text, fields={"note": text}))
    assert "swordfish" not in reported
    assert "[hidden]" in reported
    assert "abc" not in form().format(record("failed", exc_info=fault())).replace("Traceback", "")


@pytest.fixture
def _fresh_loggers():
    """Give loggers as a new process has them, and put them back: a server of another test leaves its own settings."""
    names = ("", "uvicorn", "uvicorn.error", "uvicorn.access", "httpx", "httpcore", "sqlalchemy", "sqlalchemy.pool")
    loggers = [logging.getLogger(name) for name in names]
    kept = [(list(each.handlers), each.level, each.propagate) for each in loggers]
    for each in loggers[1:]:
        each.handlers[:] = []
        each.setLevel(logging.NOTSET)
        each.propagate = True
    yield
    for each, (handlers, level, propagate) in zip(loggers, kept, strict=True):
        each.handlers[:] = handlers
        each.setLevel(level)
        each.propagate = propagate
    logging.captureWarnings(capture=False)


@pytest.mark.usefixtures("_fresh_loggers")
def test_every_logger_of_the_process_writes_the_same_form():
    out = io.StringIO()
    write_log("info", "json", out)
    logging.getLogger("uvicorn.error").info("started")
    logging.getLogger("sqlalchemy.pool").warning("slow")
    logging.getLogger("uvicorn.access").info("not this one")
    assert [json.loads(line)["logger"] for line in out.getvalue().splitlines()] == ["uvicorn.error", "sqlalchemy.pool"]
