"""Receivers of alarms: a mail server with TLS and log-in, and an HTTP server that may refuse."""

import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email import message_from_bytes
from email.message import Message
from email.policy import default
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import trustme
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult, Envelope, Session
from processes import free_port

PASSWORD = "correct horse"


@dataclass
class Mailbox:
    """A mail server; `answers` has what it says to an address instead of taking it."""

    port: int
    ca_file: Path
    answers: dict[str, list[str]] = field(default_factory=dict)
    got: list[tuple[list[str], Message]] = field(default_factory=list)
    judge: Callable[[Message], str] | None = None  # gives the answer to a text
    judge_size: Callable[[], str | None] = lambda: None  # gives one to a size, before the text
    options: dict[str, Any] = field(default_factory=dict)

    async def handle_MAIL(  # noqa: N802
        self, server: Any, session: Session, envelope: Envelope, address: str, options: list[str]
    ) -> str:
        answer = self.judge_size() if any(one.startswith("SIZE=") for one in options) else None
        if answer is not None:
            return answer
        envelope.mail_from = address
        envelope.mail_options.extend(options)
        return "250 OK"

    async def handle_RCPT(  # noqa: N802
        self, server: Any, session: Session, envelope: Envelope, address: str, options: list[str]
    ) -> str:
        answers = self.answers.get(address)
        if answers:
            return answers.pop(0)
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(  # noqa: N802
        self, server: Any, session: Session, envelope: Envelope
    ) -> str:
        content = envelope.content
        assert isinstance(content, bytes)
        message = message_from_bytes(content, policy=default)
        answer = "250 taken" if self.judge is None else self.judge(message)
        if answer.startswith("250"):
            self.got.append((list(envelope.rcpt_tos), message))
        return answer


@pytest.fixture
def mailbox(tmp_path: Path) -> Iterator[Mailbox]:
    authority = trustme.CA()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert("localhost").configure_cert(context)
    ca_file = tmp_path / "ca.pem"
    authority.cert_pem.write_to_path(ca_file)
    box = Mailbox(free_port(), ca_file)

    def judge(server: Any, session: Any, envelope: Any, mechanism: str, data: Any) -> AuthResult:
        known = data.login == b"twin" and data.password == PASSWORD.encode()
        return AuthResult(success=known, handled=False)

    controller = Controller(
        box,
        hostname="127.0.0.1",
        port=box.port,
        ready_timeout=60,
        tls_context=context,
        require_starttls=True,
        auth_required=True,
        authenticator=judge,
    )
    box.options = controller.SMTP_kwargs
    controller.start()
    yield box
    controller.stop()
    controller.loop.close()


@dataclass
class Hook:
    """An HTTP receiver; `refusals` are the answers to the next posts, then `judge` or all."""

    server: ThreadingHTTPServer
    refusals: list[int] = field(default_factory=list)
    posts: list[tuple[int, dict[str, str], bytes]] = field(default_factory=list)
    judge: Callable[[bytes], int] | None = None  # gives the answer to a body

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.server_address[1]}/hooks/secret-path"

    @property
    def taken(self) -> list[tuple[int, dict[str, str], bytes]]:
        return [one for one in self.posts if one[0] == 204]


@contextmanager
def running_hook() -> Iterator[Hook]:
    """An HTTP server on a free port that takes posts."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            status = found.refusals.pop(0) if found.refusals else 204
            if found.judge is not None:
                status = found.judge(body)
            headers = {name.lower(): value for name, value in self.headers.items()}
            found.posts.append((status, headers, body))
            self.send_response(status)
            if status == 302:
                self.send_header("location", found.url)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            """Keep the test's output clean."""

    found = Hook(ThreadingHTTPServer(("127.0.0.1", 0), Handler))
    thread = threading.Thread(target=found.server.serve_forever)
    thread.start()
    try:
        yield found
    finally:
        found.server.shutdown()
        thread.join()
        found.server.server_close()


@pytest.fixture
def hook() -> Iterator[Hook]:
    with running_hook() as found:
        yield found
