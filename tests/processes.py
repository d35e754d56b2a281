"""Real processes for tests: virtual bench and service, started as a user would start them."""

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx2
from patience import patience

from service.clock import ProcessClock, rfc3339
from service.demo.configuration import ASSET, write_configuration
from service.domain.roles import Role
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

START_S = 90.0
STOP_S = 60.0
TESTS = str(Path(__file__).parent)

Found = TypeVar("Found")


#: The service ends a connection that rests for 5 s; a call that takes it at that moment is lost.
LIMITS = httpx2.Limits(keepalive_expiry=2.0)


#: Ports that were given, the newest last: a stand takes several before it listens on the first.
_GIVEN: deque[int] = deque(maxlen=500)


def free_port() -> int:
    """A port that nobody listens on, below those that outgoing connections are given.

    A test that starts a server anew on the same port would else find it taken now and then; tests
    that run beside it in another worker of pytest-xdist take theirs from another range.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    first = 20_000 + worker % 8 * 1500
    while True:
        port = random.randrange(first, first + 1500)
        if port in _GIVEN:
            continue
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        _GIVEN.append(port)
        return port


def wait_until(
    look: Callable[[], Found | None], timeout_s: float, what: str, every_s: float = 0.1
) -> Found:
    """Wait for something that is neither None nor False; fail when it does not come."""
    timeout_s = patience(timeout_s)
    deadline = time.monotonic() + timeout_s
    while True:
        found = look()
        if found is not None and found is not False:
            return found
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {timeout_s:g} s: {what}")
        time.sleep(every_s)


def hasty(*arguments: str) -> list[str]:
    """A command line of ``bearing-twin`` that waits for another service for seconds only.

    What a user starts waits up to a minute, and then does the same.
    """
    text = (
        f"import os, sys; os.environ['PYTHONPATH'] = {TESTS!r}; sys.path.insert(0, {TESTS!r}); "
        "import hasty; from service.app import forking; from service.cli import main; "
        "forking.PRELOADED.insert(0, 'hasty'); main()"
    )
    return [sys.executable, "-c", text, *arguments]


class Command:
    """One ``bearing-twin`` process; its first line of output says that it listens.

    Parameters
    ----------
    arguments
        Of the command.
    log
        Where its standard error goes.
    under
        A program that starts it, with its arguments: ``("prlimit", "--nofile=1024:1024")``.
    """

    def __init__(self, arguments: list[str], log: Path, under: Sequence[str] = ()) -> None:
        self.log = log
        with log.open("ab") as errors:
            self.process = subprocess.Popen(
                [*under, sys.executable, "-m", "service", *arguments],
                stdout=subprocess.PIPE,
                stderr=errors,
                stdin=subprocess.DEVNULL,
                text=True,
                # A process group of its own, so that all its processes can be killed at once.
                start_new_session=True,
            )
        assert self.process.stdout is not None
        try:
            self.first_line = self.process.stdout.readline().strip()
        except BaseException:  # the test's time is over
            self.kill_all()
            raise
        assert self.first_line, f"{arguments[0]} did not start: {log.read_text()[-2000:]}"

    def terminate(self) -> int:
        """Send SIGTERM and return the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self._ended()

    def kill(self) -> int:
        """Pull the plug: every process of the command ends at once."""
        self.kill_all()
        return self._ended()

    def processes(self) -> dict[int, str]:
        """All processes of the command with their names."""
        found = {}
        for status in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                name, _, rest = status.read_text().partition("(")[2].rpartition(")")
                if int(rest.split()[3]) == self.process.pid:
                    found[int(status.parent.name)] = name
        return found

    def side(self, name: str) -> int:
        """The process of one side of a service (cell, web, plant); waits while it starts again."""
        return wait_until(
            lambda: next((p for p, n in self.processes().items() if n == f"twin-{name}"), None),
            START_S,
            f"a process of the {name} side",
            every_s=0.01,
        )

    @contextlib.contextmanager
    def frozen(self, *sides: str) -> Iterator[None]:
        """Let sides of a service stand still, and its supervisor, which would end them for that."""
        still = [self.process.pid, *map(self.side, sides)]
        for process in still:
            os.kill(process, signal.SIGSTOP)
        try:
            yield
        finally:
            for process in reversed(still):
                os.kill(process, signal.SIGCONT)

    def kill_all(self) -> None:
        """Kill the command and all that it started, which may live longer than it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def _ended(self) -> int:
        status = self.process.wait(STOP_S)
        if self.process.stdout is not None:
            self.process.stdout.close()
        return status

    def end(self) -> None:
        """Clear away, whatever has become of it."""
        self.kill_all()
        if self.process.poll() is None:
            self._ended()
        elif self.process.stdout is not None:
            self.process.stdout.close()


class Station:
    """A service with its configuration, and a client with a key for it."""

    def __init__(self, folder: Path, configuration: Path, port: int) -> None:
        self.folder, self.configuration, self.port = folder, configuration, port
        self.address = f"http://127.0.0.1:{port}"
        self._keys: dict[str, str] = {}
        self.key = self.key_of("admin")
        self.service: Command | None = None
        self.client = httpx2.Client(
            base_url=self.address,
            headers={"X-API-Key": self.key},
            timeout=patience(60),
            limits=LIMITS,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start_service(self, *under: str) -> Command:
        """Start the service, by another program with its arguments if need be."""
        arguments = ["serve", "-c", str(self.configuration)]
        self.service = Command(arguments, self.folder / "serve.log", under)
        return self.service

    def now_us(self) -> int:
        """The service's process time."""
        settings = load_settings(self.configuration)
        return ProcessClock.resume(settings.clock.rate, settings.data_dir).now_us()

    def open_store(self) -> Store:
        settings = load_settings(self.configuration)
        return Store.open(settings.service.database_url, settings.data_dir)

    def key_of(self, role: Role) -> str:
        """A key of a role, made once."""
        if role not in self._keys:
            with self.open_store() as store:
                self._keys[role] = create_key(store, role).text
        return self._keys[role]

    def get(self, path: str, **parameters: Any) -> Any:
        answer = self.client.get(path, params=parameters)
        assert answer.status_code == httpx2.codes.OK, answer.text
        return answer.json()

    def push(
        self, asset: str, client: httpx2.Client | None = None, /, **values: float
    ) -> httpx2.Response:
        """Push values that are measured now."""
        now = rfc3339(self.now_us())
        samples = [{"channel": name, "time": now, "value": value} for name, value in values.items()]
        path = f"/api/v1/assets/{asset}/measurements"
        return (client or self.client).post(path, json={"samples": samples})

    @contextlib.contextmanager
    def pushing(
        self, asset: str, values: Callable[[], Mapping[str, float]], every_s: float = 0.5
    ) -> Iterator[Callable[[], None]]:
        """Push again and again, whatever becomes of it; gives what ends that."""
        stop = threading.Event()
        gateway = httpx2.Client(
            base_url=self.address, headers=self.client.headers, timeout=patience(3.0)
        )

        def work() -> None:
            while not stop.wait(every_s):
                with contextlib.suppress(httpx2.TransportError):
                    self.push(asset, gateway, **values())

        thread = threading.Thread(target=work)
        thread.start()

        def end() -> None:
            stop.set()
            thread.join()

        try:
            yield end
        finally:
            end()
            gateway.close()

    def tags(self, asset: str = ASSET) -> dict[str, Any]:
        tags: dict[str, Any] = self.get(f"/api/v1/assets/{asset}/snapshot")["tags"]
        return tags

    def tag(self, name: str, asset: str = ASSET) -> Any:
        return self.tags(asset)[name]["value"]

    def check(self, name: str) -> dict[str, Any]:
        """A check of the service's readiness; one without status while it is not there."""
        with contextlib.suppress(httpx2.TransportError):
            for check in self.client.get("/readyz").json()["checks"]:
                if check["name"] == name:
                    return dict(check)
        return {"name": name, "status": None, "detail": None}

    def close(self) -> None:
        self.client.close()
        if self.service is not None:
            self.service.end()


class Site(Station):
    """A virtual bench and a service beside it, both of which can be stopped and started again.

    Parameters
    ----------
    folder
        Empty directory for configuration, data and logs.
    scenario, rate, seed
        What the bench runs, and how fast.
    service_keys
        Lines for the configuration's section of the service.
    pushed
        A channel that is not read from a wire but pushed over HTTP.
    """

    def __init__(
        self,
        folder: Path,
        scenario: str,
        rate: float,
        seed: int = 1,
        service_keys: str = "",
        pushed: str = "",
    ) -> None:
        self.scenario, self.rate, self.seed = scenario, rate, seed
        self.modbus_port, self.can_port = free_port(), free_port()
        self.bench: Command | None = None
        bench = {
            "modbus": {"host": "127.0.0.1", "port": self.modbus_port},
            "can": {"channel": f"socket://127.0.0.1:{self.can_port}"},
        }
        port = free_port()
        configuration = write_configuration(folder, [bench], rate, port)
        text = configuration.read_text()
        text = text.replace("[service]\n", f"[service]\n{service_keys}\n", 1)
        if pushed:
            section = "[assets.channels]\n"
            text = text.replace(section, f'{section}{pushed} = {{ source = "push" }}\n', 1)
        configuration.write_text(text)
        super().__init__(folder, configuration, port)

    def start_bench(self) -> None:
        self.bench = Command(
            [
                "virtual-bench", "--scenario", self.scenario, "--rate", f"{self.rate:g}",
                "--seed", str(self.seed), "--modbus-port", str(self.modbus_port),
                "--can-port", str(self.can_port), "--json",
            ],
            self.folder / "bench.log",
        )  # fmt: skip
        assert json.loads(self.bench.first_line)["modbus"]["port"] == self.modbus_port

    def close(self) -> None:
        super().close()
        if self.bench is not None:
            self.bench.end()
