"""A configuration with a password that every user of the machine can read."""

from pathlib import Path

import pytest

from service.site.configuration import readable_secrets

SECRET = """
[service]
database_url = "postgresql://twin:hidden@db/twin"
[fleet]
nats_url = "nats://bus:4222"
[mqtt]
password = "hidden"
username = "twin"
[[notifications]]
id = "chat"
url = "https://chat.example/hidden"
secret_variable = "KEY"
[smtp]
password = ""
"""


@pytest.mark.parametrize(("mode", "count"), [(0o644, 1), (0o604, 1), (0o640, 0), (0o600, 0)])
def test_it_is_said_which_of_them_can_be_read(tmp_path: Path, mode: int, count: int) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(SECRET)
    file.chmod(mode)
    found = readable_secrets(file)
    assert len(found) == count
    for line in found:
        names = "service.database_url, mqtt.password, notifications[0].url; expected mode 0640"
        assert line.startswith(f"every user of this machine can read {names}")
        assert "hidden" not in line


def test_a_file_without_a_secret_may_be_read_by_everybody(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text('[service]\ndatabase_url = "postgresql://twin@db/twin"\n'.replace("twin@", ""))
    file.chmod(0o644)
    assert readable_secrets(file) == []
    assert readable_secrets(None) == readable_secrets(tmp_path / "not-there.toml") == []
