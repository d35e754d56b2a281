"""Callers who have the cell work for them: silences, acknowledgements, questions for its health."""

import http.client
import json
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Protocol

#: Alarms of one call, none of which there is.
_IDS = 500
_COLUMNS = 100_000


class Attacker(Protocol):
    """What an attack needs of `bearing_twin_laboratory.benchmarks.attackers.Attack`."""

    host: str
    port: int

    def note(self, what: object) -> None:
        """Count an answer."""

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> int:
        """Make one call to its end; gives its status, 0 without an answer."""

    def side_by_side(self, count: int, work: Callable[[int], None]) -> None:
        """Do a work again and again in so many threads, to the end."""


def silences(attack: Attacker) -> None:
    """Plan silences on a schedule without end, and look how the notifications are."""
    ends_at = (datetime.now(UTC) + timedelta(hours=20)).isoformat()
    weekly = {"begins": "00:00", "ends": "00:01", "time_zone": "Asia/Tokyo"}
    body = json.dumps({"ends_at": ends_at, "weekly": weekly, "comment": "shift"}).encode()

    def once(number: int) -> None:
        attack.ask("POST", "/silences", body)
        attack.ask("GET", "/notifications")

    attack.side_by_side(4, once)


def acknowledgements(attack: Attacker) -> None:
    """Acknowledge five hundred alarms that there are not, and comment on one, again and again."""
    body = json.dumps({"ids": [f"{number:032x}" for number in range(_IDS)]}).encode()
    comment = json.dumps({"comment": "x" * 500}).encode()

    def once(number: int) -> None:
        if number % 2:
            status = attack.ask("POST", f"/alarms/{number:032x}/comment", comment)
        else:
            status = attack.ask("POST", "/alarms/acknowledge", body)
        if status in (429, 503):
            time.sleep(0.2)

    attack.side_by_side(8, once)


def readyz(attack: Attacker) -> None:
    """Eight callers without a key who ask whether the service is ready, and for its metrics."""

    def once(number: int) -> None:
        connection = http.client.HTTPConnection(attack.host, attack.port, timeout=10)
        try:
            connection.request("GET", ("/readyz", "/metrics")[number % 2])
            answer = connection.getresponse()
            answer.read()
            attack.note(answer.status)
        except http.client.HTTPException as error:
            attack.note(type(error).__name__)
        finally:
            connection.close()

    attack.side_by_side(8, once)


def sheets(attack: Attacker) -> None:
    """Upload lists of assets with a hundred thousand columns: transposed ones."""
    body = ",".join(["id", *(f"column {number}" for number in range(_COLUMNS))]).encode()

    def once(number: int) -> None:
        status = attack.ask("POST", "/assets:import", body, **{"Content-Type": "text/csv"})
        if status in (429, 503):
            time.sleep(0.2)

    attack.side_by_side(2, once)
