"""How the files of the page are sent, those of the folder and those that are packed."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from service.web.api.page import page_version
from service.web.pages import static_directory

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


async def test_the_page_says_which_version_it_is(world: Any, tmp_path: Path) -> None:
    client = world.client()
    first = (await client.get("/")).text
    version = re.findall(r'<html data-version="([0-9a-f]{16})" ', first)
    assert len(version) == 1
    assert (await client.get("/", headers={"Sec-Fetch-Site": "none"})).text.count(version[0]) == 1
    static = Path(shutil.copytree(static_directory(), tmp_path / "static"))
    assert page_version(static) == version[0]
    (static / "js/whatif/view.js").write_text("export class View {}\n")
    assert page_version(static) != version[0]


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
