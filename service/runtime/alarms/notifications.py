"""Notices of alarms to the outside: queues with a thread each, so that no receiver makes anybody wait.

A queue is bounded: what it has no place for is dropped, oldest first, and counted. What cannot be delivered after all
attempts is counted too; an alarm that nobody acts on is told again by itself.

Delivery: by e-mail, or by HTTP as a POST with a signature that tells the receiver who sent it. ``SOO-Timestamp`` is the
time of sending in seconds, ``SOO-Signature`` is ``sha256=`` and the hexadecimal HMAC-SHA256 of timestamp, a dot and the
body under the shared secret. A receiver refuses old timestamps, so nothing can be sent twice by a stranger, and drops a
``sequence`` that it has seen: an attempt whose answer was lost is made again.
"""

import hmac
import json
import logging
import smtplib
import ssl
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from email.message import EmailMessage
from hashlib import sha256
from typing import Any

from service.client.backoff import Backoff
from service.pipeline.alarms.states import AlarmCondition
from service.records.epoch import US_PER_S, format_epoch
from service.records.operations.alarms import AlarmChange, Severity

_LOG = logging.getLogger("soo.notices")

#: notices that one channel holds
CAPACITY = 1000
#: attempts for one notice
ATTEMPTS = 6


class DeliveryError(Exception):
    """A notice did not arrive; whether another attempt makes sense is said by ``is_final``."""

    def __init__(self, words: str, *, is_final: bool = False) -> None:
        super().__init__(words)
        self.is_final = is_final


@dataclass(slots=True)
class NoticeCounts:
    """Counters of the notices of one channel."""

    sent: int = 0
    #: given up after all attempts, or refused by the receiver
    failed: int = 0
    #: no place in the queue
    dropped: int = 0


class NoticeChannel:
    """A bounded queue and a thread that delivers from it.

    Parameters
    ----------
    name : str
        What the log and the figures call it.
    deliver : callable
        Delivers one document; raises DeliveryError.
    conditions : mapping
        Table of conditions, for what to do next.
    from_severity : Severity
        Alarms below are not told.
    backoff : callable
        Makes the waiting times between attempts.
    capacity : int
        Notices that wait at most.
    """

    def __init__(
        self,
        name: str,
        deliver: Callable[[dict[str, Any]], None],
        conditions: Mapping[str, AlarmCondition],
        from_severity: Severity,
        backoff: Callable[[], Backoff] = Backoff,
        capacity: int = CAPACITY,
    ) -> None:
        self.name = name
        self.counts = NoticeCounts()
        self._deliver = deliver
        self._conditions = conditions
        self._from_severity = from_severity
        self._backoff = backoff
        self._capacity = capacity
        self._queue: deque[AlarmChange] = deque()
        self._arrived = threading.Condition()
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"soo-{name}", daemon=True)

    def start(self) -> None:
        """Deliver from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End without waiting for receivers that do not answer; the alarms themselves are in the archive."""
        self._is_stopping.set()
        with self._arrived:
            self._arrived.notify()
        if self._thread.is_alive():
            self._thread.join(2.0)

    @property
    def waiting(self) -> int:
        """How many notices wait."""
        return len(self._queue)

    def offer(self, change: AlarmChange) -> None:
        """Queue a change that is to be told; the oldest one makes place where there is none."""
        if not change.is_told or change.alarm.severity < self._from_severity:
            return
        with self._arrived:
            self._queue.append(change)
            if len(self._queue) > self._capacity:
                self._queue.popleft()
                self.counts.dropped += 1
            self._arrived.notify()

    def _run(self) -> None:
        """Deliver until stopped."""
        while not self._is_stopping.is_set():
            with self._arrived:
                while not self._queue and not self._is_stopping.is_set():
                    self._arrived.wait()
                if self._is_stopping.is_set():
                    return
                change = self._queue.popleft()
            self._try(notice_of(change, self._conditions))

    def _try(self, notice: dict[str, Any]) -> None:
        """Deliver one notice, with pauses between attempts."""
        backoff = self._backoff()
        for attempt in range(1, ATTEMPTS + 1):
            try:
                self._deliver(notice)
            except DeliveryError as error:
                if error.is_final or attempt == ATTEMPTS:
                    self.counts.failed += 1
                    _LOG.error(
                        "notice %s to channel %s failed, not sent again: %s", notice["sequence"], self.name, error
                    )
                    return
                if self._is_stopping.wait(backoff.next_s()):
                    return
            except Exception:  # noqa: BLE001 the next notice must go out whatever this one broke
                self.counts.failed += 1
                _LOG.exception("notice %s to channel %s failed", notice["sequence"], self.name)
                return
            else:
                self.counts.sent += 1
                return


def notice_of(change: AlarmChange, conditions: Mapping[str, AlarmCondition]) -> dict[str, Any]:
    """Return a notice: JSON without NaN, epochs as in the interface."""
    alarm, condition = change.alarm, conditions.get(change.alarm.condition)
    return {
        "sequence": change.sequence,
        "change": change.kind.value,
        "at": format_epoch(change.at_us),
        "alarm_id": alarm.id,
        "spacecraft_id": alarm.spacecraft_id,
        "condition": alarm.condition,
        "thing": alarm.thing,
        "state": alarm.state,
        "severity": alarm.severity.word,
        "since": format_epoch(alarm.since_us),
        "value": _finite(alarm.value),
        "value_at": format_epoch(alarm.value_at_us),
        "limit": _finite(alarm.limit),
        "unit": alarm.unit,
        "detail": alarm.detail,
        "next_step": "" if condition is None else condition.next_step,
        "repeats": alarm.repeats,
        "by": None if change.handling is None else change.handling.by,
        "comment": None if change.handling is None else change.handling.comment,
    }


def _finite(value: float) -> float | None:
    """Return None for what JSON cannot tell."""
    return value if abs(value) < float("inf") else None


#: what is worth a letter; who acknowledges an alarm knows of it
_REPORTED = frozenset({"raised", "escalated", "repeated", "returned", "unshelved", "released"})
_FINAL_CODES = range(500, 600)


@dataclass(frozen=True, slots=True)
class MailRoute:
    """Mail server, sender and recipients of notices."""

    host: str
    port: int
    sender: str
    receivers: tuple[str, ...]
    #: none, starttls or tls
    security: str = "starttls"
    user: str = ""
    password: str = ""
    timeout_s: float = 15.0


class Mail:
    """Delivers notices as letters.

    Parameters
    ----------
    route : MailRoute
        Where to.
    """

    def __init__(self, route: MailRoute) -> None:
        self._route = route

    def deliver(self, notice: dict[str, Any]) -> None:
        """Deliver one notice; DeliveryError is final where the server refuses for good."""
        if notice["change"] not in _REPORTED:
            return
        try:
            with self._connection() as connection:
                if self._route.user:
                    connection.login(self._route.user, self._route.password)
                connection.send_message(self._letter(notice))
        except smtplib.SMTPResponseException as error:
            raise DeliveryError(
                f"server answered {error.smtp_code}", is_final=error.smtp_code in _FINAL_CODES
            ) from None
        except (smtplib.SMTPException, OSError) as error:
            raise DeliveryError(type(error).__name__) from None

    def _connection(self) -> smtplib.SMTP:
        route = self._route
        if route.security == "tls":
            context = ssl.create_default_context()
            return smtplib.SMTP_SSL(route.host, route.port, timeout=route.timeout_s, context=context)
        connection = smtplib.SMTP(route.host, route.port, timeout=route.timeout_s)
        if route.security == "starttls":
            connection.starttls(context=ssl.create_default_context())
        return connection

    def _letter(self, notice: dict[str, Any]) -> EmailMessage:
        letter = EmailMessage()
        about = notice["spacecraft_id"] or "service"
        subject = f"[{notice['severity']}] {about}: {notice['condition']} {notice['thing']} {notice['change']}"
        letter["Subject"] = " ".join(subject.split())[:200]
        letter["From"] = self._route.sender
        letter["To"] = ", ".join(self._route.receivers)
        lines = [
            notice["detail"],
            "",
            f"What to do: {notice['next_step']}",
            "",
            f"alarm {notice['alarm_id']}, {notice['state']}, {notice['change']} at {notice['at']}",
            f"POST /api/v1/alarms/{notice['alarm_id']}:acknowledge tells others that you have seen it.",
        ]
        letter.set_content("\n".join(lines))
        return letter


TIMEOUT_S = 10.0


class Webhook:
    """Delivers notices to one address.

    Parameters
    ----------
    url : str
        Where to.
    secret : str
        Shared with the receiver; empty: nothing is signed.
    now_us : callable
        The system's present, microseconds UTC.
    timeout_s : float
        Longest time for each part of an exchange.
    """

    def __init__(self, url: str, secret: str, now_us: Callable[[], int], timeout_s: float = TIMEOUT_S) -> None:
        self._url = url
        self._secret = secret.encode()
        self._now_us = now_us
        self._timeout_s = timeout_s

    def deliver(self, notice: dict[str, Any]) -> None:
        """Deliver one notice; DeliveryError is final for a 4xx other than 408, 425 and 429."""
        # a tenth of a second of the start of a service that most often has no webhook
        import httpx

        body = json.dumps(notice, allow_nan=False, ensure_ascii=False).encode()
        headers = {"Content-Type": "application/json", **self._signature(body)}
        try:
            answer = httpx.post(self._url, content=body, headers=headers, timeout=self._timeout_s)
        except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
            # the text of the error may hold the address, and the address a secret
            raise DeliveryError(type(error).__name__) from None
        if not answer.is_success:
            is_final = 400 <= answer.status_code < 500 and answer.status_code not in {408, 425, 429}
            raise DeliveryError(f"answered {answer.status_code}", is_final=is_final)

    def _signature(self, body: bytes) -> dict[str, str]:
        timestamp = str(self._now_us() // US_PER_S)
        if not self._secret:
            return {"SOO-Timestamp": timestamp}
        digest = hmac.new(self._secret, timestamp.encode() + b"." + body, sha256).hexdigest()
        return {"SOO-Timestamp": timestamp, "SOO-Signature": f"sha256={digest}"}
