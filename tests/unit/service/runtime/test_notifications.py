"""Notices reach local receivers signed and whole, and no receiver makes anybody wait."""

import hmac
import json
import socketserver
import threading
from contextlib import contextmanager
from dataclasses import replace
from email import message_from_bytes
from email.policy import default
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from busy_station import wait_for
from stored_records import ALARM

from service.client.backoff import Backoff
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations.alarms import AlarmChange, ChangeKind, Severity
from service.runtime.alarms.notifications import (
    ATTEMPTS,
    DeliveryError,
    Mail,
    MailRoute,
    NoticeChannel,
    Webhook,
    notice_of,
)

S = 1_000_000
CONDITIONS = condition_table(AlarmConfig(), RobustConfig())
SECRET = "shared"


def change(sequence=1, kind=ChangeKind.RAISED, severity=Severity.WARNING, **more):
    detail = "carrier c01: für 120 s nichts\ngefunden"
    alarm = replace(ALARM, id=5, severity=severity, value=120.0, limit=float("nan"), detail=detail)
    return AlarmChange(kind, alarm, 7 * S, **{"is_told": True, **more}, sequence=sequence)


@contextmanager
def running(channel):
    channel.start()
    try:
        yield channel
    finally:
        channel.stop()


def channel_to(deliver, **more):
    swift = {"backoff": lambda: Backoff(0.01, 0.02)}
    return NoticeChannel("test", deliver, CONDITIONS, Severity.WARNING, **{**swift, **more})


class Receiver:
    """An HTTP server that keeps what it gets and answers with the next of its answers."""

    def __init__(self, answers=()):
        self.received, self.answers = [], list(answers)
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.received.append((dict(self.headers), body))
                self.send_response(outer.answers.pop(0) if outer.answers else 204)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/hook"
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True)
        self.thread.start()

    def close(self):
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()


@pytest.fixture
def receiver():
    one = Receiver()
    yield one
    one.close()


def test_a_webhook_gets_a_signed_document(receiver):
    with running(channel_to(Webhook(receiver.url, SECRET, lambda: 42 * S).deliver)) as channel:
        channel.offer(change())
        wait_for(lambda: channel.counts.sent == 1)
    headers, body = receiver.received[0]
    assert json.loads(body) == notice_of(change(), CONDITIONS)
    expected = hmac.new(SECRET.encode(), b"42." + body, sha256).hexdigest()
    assert (headers["SOO-Timestamp"], headers["SOO-Signature"]) == ("42", f"sha256={expected}")


def test_a_notice_says_what_why_and_what_next_without_nan():
    notice = notice_of(change(), CONDITIONS)
    assert (notice["severity"], notice["value"], notice["limit"], notice["unit"]) == ("warning", 120.0, None, "s")
    assert notice["since"] == "1970-01-01T00:00:05.000000Z"
    assert notice["next_step"] == CONDITIONS["carrier_absent"].next_step
    json.dumps(notice, allow_nan=False)


def test_a_receiver_that_fails_for_a_while_gets_every_notice_in_order(receiver):
    receiver.answers += [503, 500, 429]
    with running(channel_to(Webhook(receiver.url, SECRET, lambda: 0).deliver)) as channel:
        for sequence in (1, 2):
            channel.offer(change(sequence))
        wait_for(lambda: channel.counts.sent == 2)
    assert [json.loads(body)["sequence"] for _, body in receiver.received] == [1, 1, 1, 1, 2]
    assert channel.counts.failed == 0


def test_a_refusal_for_good_is_not_tried_again(receiver):
    receiver.answers += [401]
    with running(channel_to(Webhook(receiver.url, "", lambda: 0).deliver)) as channel:
        channel.offer(change(1))
        channel.offer(change(2))
        wait_for(lambda: channel.counts.sent == 1)
    assert channel.counts.failed == 1
    assert "SOO-Signature" not in receiver.received[0][0]


def test_what_cannot_be_delivered_is_given_up_and_counted():
    asked = []

    def fail(notice):
        asked.append(notice)
        raise DeliveryError("away")

    with running(channel_to(fail)) as channel:
        channel.offer(change())
        wait_for(lambda: channel.counts.failed == 1)
    assert len(asked) == ATTEMPTS


def test_a_fault_of_one_notice_does_not_keep_the_next():
    reported = []

    def deliver(notice):
        if notice["sequence"] == 1:
            raise RuntimeError("on purpose")
        reported.append(notice["sequence"])

    with running(channel_to(deliver)) as channel:
        channel.offer(change(1))
        channel.offer(change(2))
        wait_for(lambda: reported == [2])


def test_a_receiver_that_hangs_makes_nobody_wait_and_the_oldest_notices_are_dropped():
    release, begun = threading.Event(), threading.Event()

    def hang(_notice):
        begun.set()
        release.wait(120.0)

    with running(channel_to(hang, capacity=3)) as channel:
        channel.offer(change(0))
        assert begun.wait(120.0)
        for sequence in range(1, 1001):
            channel.offer(change(sequence))
        assert (channel.waiting, channel.counts.dropped) == (3, 997)
        release.set()


def test_what_is_not_to_be_told_or_matters_less_is_not_offered():
    channel = channel_to(lambda _: None)
    channel.offer(change(is_told=False))
    channel.offer(change(severity=Severity.WATCH))
    assert channel.waiting == 0


def test_no_address_and_no_secret_stands_in_an_error():
    hook = Webhook("http://127.0.0.1:1/token-of-the-address", "top-secret", lambda: 0, timeout_s=0.5)
    with pytest.raises(DeliveryError) as caught:
        hook.deliver({"a": 1})
    assert "token" not in str(caught.value)
    assert caught.value.__cause__ is None


class MailServer(socketserver.ThreadingTCPServer):
    """As much SMTP as a letter needs."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, refusal=None):
        self.letters, self.refusal = [], refusal
        super().__init__(("127.0.0.1", 0), _Session)


class _Session(socketserver.StreamRequestHandler):
    def handle(self):
        self.say("220 test")
        for line in self.rfile:
            word = line[:4].upper()
            if word == b"DATA":
                self.consume()
            elif word == b"MAIL" and self.server.refusal:
                self.say(self.server.refusal)
            elif word == b"QUIT":
                self.say("221 bye")
                return
            else:
                self.say("250 ok")

    def consume(self):
        self.say("354 go on")
        lines = []
        for line in self.rfile:
            if line == b".\r\n":
                break
            lines.append(line)
        self.server.letters.append(b"".join(lines))
        self.say("250 taken")

    def say(self, text):
        self.wfile.write(text.encode() + b"\r\n")


@contextmanager
def mail_server(**more):
    server = MailServer(**more)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def route_to(server):
    return MailRoute("127.0.0.1", server.server_address[1], "soo@x.test", ("a@x.test", "b@x.test"), security="none")


def test_a_letter_says_it_all_and_only_what_is_worth_one():
    with mail_server() as server, running(channel_to(Mail(route_to(server)).deliver)) as channel:
        channel.offer(change(kind=ChangeKind.ACKNOWLEDGED))
        channel.offer(change())
        wait_for(lambda: channel.counts.sent == 2)
        (raw,) = server.letters
    letter = message_from_bytes(raw, policy=default)
    assert letter["To"] == "a@x.test, b@x.test"
    assert letter["Subject"] == "[warning] craft: carrier_absent c01 raised"
    text = letter.get_content()
    assert "für 120 s" in text
    assert CONDITIONS["carrier_absent"].next_step in " ".join(text.split())


@pytest.mark.parametrize(("refusal", "attempts"), [("550 no", 1), ("451 later", ATTEMPTS)])
def test_a_mail_server_that_refuses_for_good_is_not_asked_again(refusal, attempts):
    asked = []

    def deliver(notice):
        asked.append(notice)
        Mail(route_to(server)).deliver(notice)

    with mail_server(refusal=refusal) as server, running(channel_to(deliver)) as channel:
        channel.offer(change())
        wait_for(lambda: channel.counts.failed == 1)
    assert len(asked) == attempts


def test_a_mail_server_that_is_away_is_asked_again():
    route = MailRoute("127.0.0.1", 1, "soo@x.test", ("a@x.test",), security="tls", timeout_s=1.0)
    with pytest.raises(DeliveryError) as caught:
        Mail(route).deliver(notice_of(change(), CONDITIONS))
    assert not caught.value.is_final
