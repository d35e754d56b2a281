"""Every face of a service that is killed and frozen, part by part: no client is shown what is old.

A client that is alive has, within 10 s, the present value or a status that is not good.
"""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from faces import FACES, Faces
from processes import wait_until

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900)]

OLD_S = 10.0
#: Seconds after which a face is looked at as well again; a busy machine is given more.
BACK_S = 120.0
FROZEN_S = 20.0
#: What node-opcua sends in half a minute of watching one tag, with a restart of the server.
MOST_REQUESTS = 200


@dataclass
class Course:
    """What became of the faces while a part was lost."""

    #: Longest time by which a face was wrong: its client showed something old as good.
    oldest_s: dict[str, float]
    #: Wall seconds from the fault until it showed the present again for good.
    back_s: dict[str, float]
    requests: dict[str, int]
    seconds: float


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Faces]:
    with Faces(tmp_path_factory.mktemp("faces")).running() as site:
        yield site


def plant_killed(site: Faces) -> None:
    assert site.service is not None
    os.kill(site.service.side("plant"), signal.SIGKILL)


def cell_killed(site: Faces) -> None:
    assert site.service is not None
    os.kill(site.service.side("cell"), signal.SIGKILL)


def cell_hangs(site: Faces) -> None:
    assert site.service is not None
    os.kill(site.service.side("cell"), signal.SIGSTOP)


def cell_frozen(site: Faces) -> None:
    """With the supervisor, which would end it: as a cell that has none, or on a frozen machine."""
    assert site.service is not None
    os.kill(site.service.process.pid, signal.SIGSTOP)
    os.kill(site.service.side("cell"), signal.SIGSTOP)


@pytest.fixture(scope="module", params=[plant_killed, cell_killed, cell_hangs, cell_frozen])
def course(site: Faces, request: pytest.FixtureRequest) -> Course:
    """Watch all faces from a fault until every one is well again."""
    assert site.service is not None
    for name in FACES:
        wait_until(lambda name=name: site.is_present(name, 5.0), BACK_S, name)  # type: ignore[misc]
    before = dict(site.faces["OPC UA"].requests)
    cell = site.service.side("cell")
    request.param(site)
    began_s = time.monotonic()
    oldest_s = dict.fromkeys(FACES, 0.0)
    back_s: dict[str, float] = {}
    least_s = FROZEN_S + 5.0
    frozen = [cell, site.service.process.pid] if request.param is cell_frozen else []
    while (passed_s := time.monotonic() - began_s) < BACK_S:
        while frozen and passed_s > FROZEN_S:
            os.kill(frozen.pop(0), signal.SIGCONT)
        for name in FACES:
            shown = site.faces[name].shown
            age_s = site.age_s(shown)
            if shown.good:
                oldest_s[name] = max(oldest_s[name], age_s)
            if shown.good and age_s <= OLD_S:
                back_s.setdefault(name, passed_s)
            else:
                back_s.pop(name, None)
        if passed_s > least_s and len(back_s) == len(FACES):
            break
        time.sleep(0.1)
    after = site.faces["OPC UA"].requests
    requests = {name: count - before.get(name, 0) for name, count in after.items()}
    course = Course(oldest_s, back_s, requests, passed_s)
    print(f"\n{request.param.__name__}: {course}")  # noqa: T201 - figures, with pytest -s
    return course


@pytest.mark.endurance
@pytest.mark.parametrize("face", FACES)
def test_no_client_is_shown_what_is_old_as_good(course: Course, face: str) -> None:
    assert course.oldest_s[face] <= OLD_S
    assert face in course.back_s, "it shows the present again"


@pytest.mark.endurance
def test_node_opcua_sends_a_bounded_number_of_requests(course: Course) -> None:
    assert sum(course.requests.values()) < MOST_REQUESTS, course.requests
    assert course.requests.get("RepublishRequest", 0) <= 10


def test_node_opcua_has_values_again_within_30_s_of_a_plant_side_that_was_killed(
    site: Faces,
) -> None:
    plant_killed(site)
    wait_until(lambda: not site.faces["OPC UA"].shown.good, 10.0, "node-opcua sees the loss")
    wait_until(lambda: site.is_present("OPC UA", 5.0), 30.0, "the present value")


def test_the_status_word_says_that_data_are_missing_when_the_source_is_killed(site: Faces) -> None:
    def word() -> int:
        return wait_until(site.status_word, BACK_S, "an answer of the Modbus server")

    wait_until(lambda: word() & 4 == 0, BACK_S, "all inputs are there")
    site.device.kill()
    try:
        wait_until(lambda: word() & 4 == 4, OLD_S, "an input is lost")
    finally:
        site.device.start()
    wait_until(lambda: word() & 4 == 0, BACK_S, "all inputs are there again")
