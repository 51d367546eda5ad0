"""Notices by e-mail."""

import smtplib
import ssl
from dataclasses import dataclass
from email.message import EmailMessage
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
