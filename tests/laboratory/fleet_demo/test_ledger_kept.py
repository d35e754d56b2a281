"""A demo of the fleet that fails keeps what it saw: folder, logs and the ledger so far."""

import json
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from adapters.samples import Sample
from bearing_twin_laboratory.fleet_demo import run as fleet_run
from bearing_twin_laboratory.fleet_demo.ledger import Pusher
from bearing_twin_laboratory.fleet_demo.site import BASE, PUSHED_CHANNEL
from bearing_twin_laboratory.fleet_demo.story import Account, Act, Story
from service.demo.processes import DemoError, folder_of
from service.store import Store, StoreError


def a_story(folder: Path, store: Store | None) -> Story:
    """One sample of two that were acknowledged is stored; a part was killed."""
    pusher = Pusher(["http://127.0.0.1:1/"], "key", ["pushed-1"])
    pusher.acknowledged["pushed-1"] = [1, 2]
    if store is not None:
        time_us = pusher._began_us + 1
        store.samples.write(
            [Sample("pushed-1", PUSHED_CHANNEL, time_us, BASE + 0.001, 192, time_us)]
        )

    @contextmanager
    def open_store() -> Any:
        if store is None:
            raise StoreError("store: does not answer")
        yield store

    async def stale_writes() -> int:
        return 0

    seen = SimpleNamespace(counts=lambda: {"fresh": 1, "marked_old": 0, "try_again": 0}, wrong=[])
    followed = SimpleNamespace(
        messages=1, connections=1, gaps_told=0, longest_silence_s=0.0, wrong=[]
    )
    stand: Any = SimpleNamespace(
        folder=folder,
        pusher=pusher,
        open_store=open_store,
        witness=SimpleNamespace(longest_s=0.5, stale_writes=stale_writes),
        watcher=SimpleNamespace(seen=seen),
        reader=SimpleNamespace(followed=followed),
        refused_writes=lambda: 0,
    )
    story = Story(stand, lambda line: None)
    story.acts.append(Act("kill -9 of cell 1", 0.5, 2.0, 3))
    return story


async def test_a_demo_that_fails_prints_the_ledger_so_far_and_keeps_it(tmp_path: Path) -> None:
    accounts: list[Account] = []
    with Store.open("", tmp_path) as store:
        story = a_story(tmp_path, store)
        await fleet_run._keep(story, tmp_path, pytest.fail, accounts.append)
    (account,) = accounts
    assert (account.count.acknowledged, account.count.stored, account.count.missing) == (2, 1, 1)
    assert not account.is_clean
    document = json.loads((tmp_path / fleet_run.LEDGER_FILE).read_text())
    assert document["acknowledged"] == {"pushed-1": [1, 2]}
    assert document["account"]["ledger"]["missing"] == 1
    assert document["acts"][0]["what"] == "kill -9 of cell 1"


async def test_without_a_store_the_numbers_are_kept_alone(tmp_path: Path) -> None:
    lines: list[str] = []
    await fleet_run._keep(a_story(tmp_path, None), tmp_path, lines.append, pytest.fail)
    assert "does not answer" in lines[0]
    document = json.loads((tmp_path / fleet_run.LEDGER_FILE).read_text())
    assert document["account"] is None
    assert document["acknowledged"] == {"pushed-1": [1, 2]}


async def test_the_folder_is_kept_and_named_whatever_failed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    @asynccontextmanager
    async def stand(folder: Path, **_: Any) -> Any:
        (folder / "cell.log").write_text("why")
        yield SimpleNamespace(folder=folder)

    class Fails:
        acts: list[Act] = []  # noqa: RUF012

        def __init__(self, stand: Any, report: Any) -> None:
            self.stand = SimpleNamespace(
                pusher=SimpleNamespace(acknowledged={"pushed-1": [7]}), open_store=None
            )

        async def begin(self) -> None:
            raise DemoError("no fresh values of pushed-6 for 120 s")

    monkeypatch.setattr(fleet_run, "running_stand", stand)
    monkeypatch.setattr(fleet_run, "Story", Fails)
    lines: list[str] = []
    with (
        pytest.raises(DemoError, match="no fresh values of pushed-6") as failed,
        folder_of("bt-test-") as folder,
    ):
        await fleet_run._whole(folder, 2, (0, 0), lines.append, pytest.fail)
    assert f"data and logs are kept in {folder}" in str(failed.value)
    assert json.loads((folder / "ledger.json").read_text())["acknowledged"] == {"pushed-1": [7]}
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()


def test_a_folder_is_kept_also_after_an_error_that_no_one_thought_of() -> None:
    with pytest.raises(ZeroDivisionError) as failed, folder_of("bt-test-") as folder:
        raise ZeroDivisionError
    assert folder.exists()
    assert str(folder) in failed.value.__notes__[0]
    folder.rmdir()
    with pytest.raises(KeyboardInterrupt), folder_of("bt-test-") as folder:
        raise KeyboardInterrupt
    assert not folder.exists(), "who ends it wants nothing of it"
