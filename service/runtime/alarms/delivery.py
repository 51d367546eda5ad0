"""Delivery of notices: by e-mail, or by HTTP as a POST with a signature that tells the receiver who sent it.

``SOO-Timestamp`` is the time of sending in seconds, ``SOO-Signature`` is ``sha256=`` and the hexadecimal HMAC-SHA256
of timestamp, a dot and the body under the shared secret. A receiver refuses old timestamps, so nothing can be sent
twice by a stranger, and drops a ``sequence`` that it has seen: an attempt whose answer was lost is made again.
"""

import hmac
import json
import smtplib
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from email.message import EmailMessage
from hashlib import sha256
from typing import Any

from service.runtime.alarms.notifications import DeliveryError

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
        """Return an open connection."""
        route = self._route
        if route.security == "tls":
            context = ssl.create_default_context()
            return smtplib.SMTP_SSL(route.host, route.port, timeout=route.timeout_s, context=context)
        connection = smtplib.SMTP(route.host, route.port, timeout=route.timeout_s)
        if route.security == "starttls":
            connection.starttls(context=ssl.create_default_context())
        return connection

    def _letter(self, notice: dict[str, Any]) -> EmailMessage:
        """Return the letter of a notice."""
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
_US_PER_S = 1_000_000


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
        """Return the headers that sign a body."""
        timestamp = str(self._now_us() // _US_PER_S)
        if not self._secret:
            return {"SOO-Timestamp": timestamp}
        digest = hmac.new(self._secret, timestamp.encode() + b"." + body, sha256).hexdigest()
        return {"SOO-Timestamp": timestamp, "SOO-Signature": f"sha256={digest}"}
