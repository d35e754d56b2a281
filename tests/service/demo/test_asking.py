"""The demo and a service that is busy: real HTTP over a real socket."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx2
import pytest

from service.demo import asking
from service.demo.asking import ask
from service.demo.processes import DemoError, folder_of

pytestmark = pytest.mark.wires


@contextmanager
def service_that_says(*statuses: int) -> Iterator[tuple[str, list[int]]]:
    """Answer with these statuses one after the other, the last one for all that follow."""
    left, said = list(statuses), []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status = left.pop(0) if len(left) > 1 else left[0]
            said.append(status)
            body = json.dumps({"status": status}).encode()
            self.send_response(status)
            if status == 503:
                self.send_header("Retry-After", "0")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Keep the test's output clean."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}", said
        server.shutdown()
        thread.join()


async def test_a_503_is_tried_again_until_there_is_an_answer() -> None:
    with service_that_says(503, 503, 200) as (address, said):
        async with httpx2.AsyncClient(base_url=address) as client:
            answer = await ask(client, "/", lambda line: None)
    assert answer.json() == {"status": 200}
    assert said == [503, 503, 200]


async def test_any_other_status_is_an_answer() -> None:
    with service_that_says(404) as (address, said):
        async with httpx2.AsyncClient(base_url=address) as client:
            assert (await ask(client, "/", lambda line: None)).status_code == 404
    assert said == [404]


async def test_who_watches_reads_what_is_waited_for_and_the_wait_has_an_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(asking, "_SAY_AFTER_WALL_S", 0.0)
    lines: list[str] = []
    with service_that_says(503) as (address, _):
        async with httpx2.AsyncClient(base_url=address) as client:
            with pytest.raises(DemoError, match=r"/forecast: no answer within 0.2 s; last: HTTP"):
                await ask(client, "/forecast", lines.append, patience_wall_s=0.2)
    assert lines == ["The service is busy; waiting for /forecast."]


async def test_a_service_that_starts_again_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asking, "_PAUSE_WALL_S", 0.05)
    with service_that_says(200) as (address, _):
        pass
    async with httpx2.AsyncClient(base_url=address) as client:
        with pytest.raises(DemoError, match="ConnectError"):
            await ask(client, "/", lambda line: None, patience_wall_s=0.2)


def fail(folder: Path) -> None:
    (folder / "service.log").write_text("why")
    raise DemoError("the bench ended", 2)


def test_a_demo_that_fails_keeps_its_folder_and_names_it() -> None:
    with (
        pytest.raises(DemoError, match="the bench ended; data and logs are kept in ") as failed,
        folder_of("bearing-twin-test-") as folder,
    ):
        fail(folder)
    assert failed.value.status == 2
    assert (folder / "service.log").read_text() == "why"
    (folder / "service.log").unlink()
    folder.rmdir()
    with folder_of("bearing-twin-test-") as folder:
        pass
    assert not folder.exists()
