"""How the files of the page are sent, those of the folder and those that are packed."""

from typing import Any

import pytest

PACKED = ("/js/app.js", "/js/parts/dom.js", "/css/first.css")


@pytest.mark.parametrize("path", [*PACKED, "/js/whatif/view.js"])
async def test_a_browser_asks_again_and_gets_a_file_once(world: Any, path: str) -> None:
    client = world.client()
    first = await client.get(path)
    assert first.status_code == 200
    assert first.headers["cache-control"] == "no-cache"
    assert first.headers["content-type"].partition(";")[0] in ("text/javascript", "text/css")
    assert first.headers["content-security-policy"].startswith("default-src 'self'")
    for known in (first.headers["etag"], f'"other", W/{first.headers["etag"]}'):
        again = await client.get(path, headers={"If-None-Match": known})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == first.headers["etag"]
    other = await client.get(path, headers={"If-None-Match": '"other"'})
    assert (other.status_code, other.content) == (200, first.content)
    head = await client.head(path)
    assert (head.status_code, head.headers["etag"]) == (200, first.headers["etag"])
    assert (await client.post(path, json={})).status_code in (404, 405)


async def test_the_packed_files_are_sent_compressed(world: Any) -> None:
    client = world.client(headers={"Accept-Encoding": "gzip"})
    for path in ("/js/app.js", "/css/first.css"):
        assert (await client.get(path)).headers["content-encoding"] == "gzip"


async def test_a_module_of_the_pack_is_a_stub_at_its_own_address(world: Any) -> None:
    client = world.client()
    assert (await client.get("/js/operator/view.js")).text == (
        "export { OperatorView } from '../app.js';\n"
    )
    assert "export class View" in (await client.get("/js/whatif/view.js")).text
