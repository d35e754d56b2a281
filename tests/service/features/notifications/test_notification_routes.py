"""Notifications over REST."""

from typing import Any


async def test_a_site_without_notifications_has_none_to_list_or_test(world: Any) -> None:
    listed = await world.client("viewer").get("/api/v1/notifications")
    assert listed.json() == {"items": [], "next": None}
    tried = await world.client("engineer").post("/api/v1/notifications/nobody:test")
    assert tried.status_code == 404
