"""Activating versions, and going back."""

import asyncio

import pytest
from job_shop import ASSET, Shop
from structlog.testing import capture_logs

from service.domain.errors import ActivationRefusedError
from service.jobs.models import first_model
from service.store import JournalFilter

from .conftest import asset_section

pytestmark = pytest.mark.wires


async def test_a_rejected_version_is_activated_only_by_force_with_a_comment(shop: Shop) -> None:
    jobs = await shop.open()
    document = first_model(shop.assets[ASSET].settings)
    shop.store.models.add(ASSET, "rejected", "worse than the active one", document, 2)
    for comment, force in ((None, False), ("try it", False), (None, True)):
        with pytest.raises(ActivationRefusedError, match="worse than the active one"):
            await jobs.activate(ASSET, 2, "engineer x", comment, force)
    assert shop.active() == (1, 1)
    shown = await jobs.activate(ASSET, 2, "engineer x", "try it", force=True)
    assert (shown.version, shown.status) == (2, "active")
    assert shop.active() == (2, 2)
    await jobs.activate(ASSET, 1, "engineer x", "back again", force=False)
    assert shop.active() == (1, 1)
    entry = shop.store.models.activations(ASSET)[-1]
    assert (entry.version, entry.who, entry.comment) == (1, "engineer x", "back again")
    assert shop.outbox.flush(30)
    assert [
        (line.kind, line.who, line.comment)
        for line in shop.store.alarms.journal(JournalFilter(events=True)).items
    ] == [
        ("model rolled back", "engineer x", "back again"),
        ("model activated", "engineer x", "try it"),
    ]


async def test_an_unknown_version_is_not_activated(shop: Shop) -> None:
    jobs = await shop.open()
    with pytest.raises(KeyError):
        await jobs.activate(ASSET, 7, "x", None, force=False)


async def test_a_version_of_another_bearing_is_not_activated(shop: Shop) -> None:
    """The configuration may have been changed since it was identified."""
    jobs = await shop.open()
    foreign = first_model(asset_section(bearing="6016"))
    shop.store.models.add(ASSET, "candidate", "", foreign, 2)
    with pytest.raises(ActivationRefusedError, match=r"6016.*6311"):
        await jobs.activate(ASSET, 2, "x", "force", force=True)
    assert shop.active() == (1, 1)


async def test_two_activations_at_a_time_leave_store_and_twin_alike(shop: Shop) -> None:
    jobs = await shop.open()
    document = first_model(shop.assets[ASSET].settings)
    shop.store.models.add(ASSET, "candidate", "", document, 2)
    for _ in range(20):
        await asyncio.gather(
            *(jobs.activate(ASSET, version, "x", None, force=False) for version in (1, 2, 1, 2))
        )
        assert shop.active()[0] == shop.active()[1]


async def test_a_version_that_others_made_active_is_taken_up(shop: Shop) -> None:
    jobs = await shop.open()
    activations = jobs.runner.activations
    settings = shop.assets[ASSET].settings
    shop.store.models.add(ASSET, "candidate", "", first_model(settings), 2)
    await activations.look()
    assert shop.active() == (1, 1)
    shop.store.models.activate(ASSET, 2, "night shift", "passed", 3)
    await activations.look()
    assert shop.active() == (2, 2)
    # One of another machine is left alone, and said once.
    other = first_model(settings.model_copy(update={"model": "paper"}))
    shop.store.models.add(ASSET, "candidate", "", other, 4)
    shop.store.models.activate(ASSET, 3, "night shift", "passed", 5)
    with capture_logs() as logs:
        await activations.look()
        await activations.look()
    assert [(one["event"], one["version"]) for one in logs] == [("model_not_taken_up", 3)]
    assert shop.assets[ASSET].active.version == 2
    assert shop.outbox.flush(30)
    (line,) = shop.store.alarms.journal(JournalFilter(events=True)).items
    assert (line.kind, line.who, line.comment) == ("model activated", "night shift", "passed")
