"""The Python client against servers that are busy, broken or not the service at all."""

import ast
import json
import ssl
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import bearing_twin_client
import httpx2
import pytest
import trustme
from bearing_twin_client import Client, ProblemError, ProfileStep, columns
from generate_documents import DOCUMENTS, OPENAPI, documents
from pydantic import ValidationError

pytestmark = pytest.mark.wires

STEP = ProfileStep(duration_s=3600, speed_rpm=6200, load_n=5500)
#: Status, headers and body.
Answer = tuple[int, dict[str, str], bytes]
EMPTY: Answer = (200, {}, b'{"next": null, "items": []}')


def busy(retry_after: str) -> Answer:
    problem = {
        "title": "Service Unavailable",
        "status": 503,
        "detail": "one forecast at a time",
        "instance": "/",
    }
    return 503, {"Retry-After": retry_after}, json.dumps(problem).encode()


@contextmanager
def served(
    *answers: Answer, certificate: trustme.LeafCert | None = None
) -> Iterator[tuple[Client, list[str]]]:
    """A client, and the requests so far of a server that gives these answers in their order."""
    left, calls = list(answers), []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length", 0)))
            calls.append(f"{self.command} {self.path}")
            status, headers, body = left.pop(0)
            self.send_response(status)
            for name, value in (headers | {"Content-Length": str(len(body))}).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        do_POST = do_GET  # noqa: N815

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        address = f"http://127.0.0.1:{server.server_port}/"
        if certificate is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            certificate.configure_cert(context)
            server.socket = context.wrap_socket(server.socket, server_side=True)
            address = f"https://localhost:{server.server_port}/"
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            with Client(address, "key") as client:
                yield client, calls
        finally:
            server.shutdown()
            thread.join()


def test_the_documents_are_those_of_the_interface_today() -> None:
    """`make descriptions` writes them again."""
    assert documents(json.loads(OPENAPI.read_text())) == DOCUMENTS.read_text()


@pytest.mark.parametrize(
    "change",
    [
        lambda schema: schema["properties"].pop("labels"),
        lambda schema: schema["required"].remove("time_s"),
        lambda schema: schema["properties"].update(model_version={"type": "string"}),
    ],
    ids=["member gone", "member optional", "other type"],
)
def test_a_change_of_the_interface_changes_the_documents(change: Callable[[Any], object]) -> None:
    openapi = json.loads(OPENAPI.read_text())
    change(openapi["components"]["schemas"]["WhatIfAnswer"])
    assert documents(openapi) != DOCUMENTS.read_text()


def test_it_needs_nothing_of_the_service() -> None:
    modules = {"bearing_twin_client", "httpx2", "pydantic", *sys.stdlib_module_names}
    for file in Path(bearing_twin_client.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                assert {alias.name.partition(".")[0] for alias in node.names} <= modules, file
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").partition(".")[0] in modules, file


def test_a_question_is_asked_again_while_the_service_is_busy() -> None:
    with served(busy("0"), busy("1"), EMPTY) as (client, calls):
        assert client.assets() == []
    assert calls == ["GET /api/v1/assets"] * 3


@pytest.mark.parametrize("retry_after", ["3600", "soon", "-1", ""])
def test_it_does_not_wait_for_longer_than_it_may(retry_after: str) -> None:
    with (
        served(busy(retry_after)) as (client, calls),
        pytest.raises(ProblemError, match="503 Service Unavailable: one forecast at a time"),
    ):
        client.assets()
    assert len(calls) == 1


def test_what_acts_is_sent_once() -> None:
    with served(busy("0"), busy("0")) as (client, calls):
        for act in (lambda: client.what_if("a", [STEP]), lambda: client.identify("a")):
            with pytest.raises(ProblemError):
                act()
    assert calls == ["POST /api/v1/assets/a/forecasts", "POST /api/v1/assets/a/identifications"]


def test_what_is_no_problem_document_is_an_error_all_the_same() -> None:
    gateway: Answer = (502, {"Content-Type": "text/html"}, b"<h1>no upstream</h1>")
    with served(gateway) as (client, _), pytest.raises(ProblemError) as refused:
        client.assets()
    error = refused.value
    assert (error.status, error.detail, error.field) == (502, "<h1>no upstream</h1>", None)
    assert error.problem is None


@pytest.mark.parametrize("body", [b"<h1>a log-in page</h1>", b"{}", b'{"items": [{}]}'])
def test_an_answer_of_something_else_is_refused(body: bytes) -> None:
    with served((200, {}, body)) as (client, _), pytest.raises(ValidationError):
        client.assets()


def test_a_redirect_does_not_take_the_key_elsewhere() -> None:
    elsewhere: Answer = (302, {"Location": "/elsewhere"}, b"")
    with served(elsewhere, EMPTY) as (client, calls), pytest.raises(ProblemError):
        client.assets()
    assert len(calls) == 1


def test_https_with_an_authority_of_the_plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    authority = trustme.CA()
    certificate = authority.issue_cert("localhost")
    with served(certificate=certificate) as (client, _), pytest.raises(httpx2.ConnectError):
        client.assets()
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))
    with served(EMPTY, certificate=certificate) as (client, _):
        assert client.assets() == []


def test_a_name_stays_one_part_of_the_address() -> None:
    with served((404, {}, b"")) as (client, calls), pytest.raises(ProblemError):
        client.state("../keys?x=1#")
    assert calls == ["GET /api/v1/assets/..%2Fkeys%3Fx%3D1%23/state"]


def test_pages_are_followed_and_make_columns() -> None:
    def page(following: str | None, *rows: dict[str, Any]) -> Answer:
        body = {"next": following, "resolution": "raw", "items": rows, "of a newer service": 1}
        return 200, {}, json.dumps(body).encode()

    def row(channel: str, second: int, value: float | None) -> dict[str, Any]:
        time = f"2026-11-21T08:00:{second:02d}.000Z"
        quality = 192 if value is not None else 0
        return {"channel": channel, "time": time, "value": value, "quality": quality}

    pages = [
        page("second page/", row("b", 1, 1.5), row("a", 1, None)),
        page("third", row("b", 2, 2.5)),
        page(None),
    ]
    with served(*pages) as (client, calls):
        found = columns(client.measurements("bench-1", ["b", "a"]))
    assert list(found) == ["b", "a"]
    assert [time.second for time in found["b"].time] == [1, 2]
    assert (found["b"].value, found["b"].quality) == ([1.5, 2.5], [192, 192])
    assert (found["a"].value, found["a"].quality) == ([None], [0])
    first = "GET /api/v1/assets/bench-1/measurements?channel=b&channel=a&resolution=raw"
    assert calls[0] == first
    assert [call.partition("cursor=")[2].partition("&")[0] for call in calls] == [
        "",
        "second+page%2F",
        "third",
    ]


def test_a_misspelt_member_is_not_sent() -> None:
    with pytest.raises(ValidationError, match="ambient"):
        ProfileStep.model_validate({"duration_s": 1, "speed_rpm": 1, "load_n": 1, "ambient": 20})
