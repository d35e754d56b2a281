"""The command that tries a notification, and what is wrong with one in a configuration."""

import json
from pathlib import Path
from typing import Any

import pytest
from receivers import Hook, hook

pytestmark = pytest.mark.wires

__all__ = ["hook"]

WEBHOOK = """
[[notifications]]
id = "hook"
kind = "webhook"
url = "{url}"
"""
MAIL = '[[notifications]]\nid = "m"\nkind = "email"\nto = ["a@example.com"]\n'
SMTP = '[smtp]\nhost = "mail.example.com"\nsender = "twin@example.com"\n'


def test_a_test_message_is_sent_and_its_failure_said(tmp_path: Path, cli: Any, hook: Hook) -> None:
    (tmp_path / "site.toml").write_text(WEBHOOK.format(url=hook.url))
    hook.refusals = [410]
    failed = cli("notifications", "test", "hook", "-c", "site.toml")
    host = hook.url.split("/")[2]
    assert (failed.returncode, failed.stdout) == (1, "")
    assert failed.stderr == f"bearing-twin: hook: {host}: answered 410\n"
    done = cli("notifications", "test", "hook", "-c", "site.toml")
    assert (done.returncode, done.stdout) == (0, f"hook: sent to {host}\n")
    assert [json.loads(body)["type"] for _, _, body in hook.posts] == ["test", "test"]


def test_an_unknown_notification_is_named_with_those_there_are(
    tmp_path: Path, refused: Any
) -> None:
    (tmp_path / "site.toml").write_text(WEBHOOK.format(url="https://example.com/x"))
    line = refused("notifications", "test", "mail", "-c", "site.toml")
    assert line == "bearing-twin: no notification 'mail'; the configuration has: hook"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (MAIL, "smtp.host: missing; notification 'm' needs it"),
        (SMTP + MAIL.replace("a@example.com", "nobody"), "notifications[0].to[0] = 'nobody': "),
        (
            SMTP + MAIL.replace("example", "bü..cher"),
            "notifications[0].to[0] = 'a@bü..cher.com': the domain is none: ",
        ),
        (
            SMTP + MAIL + "priorities = [4]\n",
            "notifications[0].priorities[0] = 4: Input should be less than or equal to 3",
        ),
        (SMTP + MAIL + MAIL, "notifications: the id 'm' is used twice; expected unique"),
        (
            SMTP + MAIL + 'quiet_hours = { begins = "22:00", ends = "06:00", priorities = [1] }\n',
            "notifications[0].quiet_hours.priorities[0] = 1: ",
        ),
        (
            SMTP + MAIL + 'quiet_hours = { begins = "22:00", ends = "06:00", time_zone = "X" }\n',
            "notifications[0].quiet_hours.time_zone = 'X': expected a time zone such as",
        ),
        (
            SMTP + MAIL + 'escalation = [{ after_min = 15, to = "boss" }]\n',
            "notifications.m.escalation.to = 'boss': expected the id of another notification",
        ),
        (
            WEBHOOK.format(url="https://a:secret@example.com"),
            "notifications[0].url: expected https://HOST/PATH or",
        ),
        (
            SMTP + 'security = "none"\nusername = "u"\npassword = "hidden"\n',
            "smtp: security = 'none' with a username: everybody on the way reads the password",
        ),
        (
            WEBHOOK.format(url="https://example.com") + 'secret_variable = "NO_SUCH"\n',
            "notifications.hook.secret_variable = 'NO_SUCH': the environment has no such variable",
        ),
    ],
)
def test_what_is_wrong_with_a_notification_is_said_by_check(
    tmp_path: Path, cli: Any, text: str, line: str
) -> None:
    (tmp_path / "site.toml").write_text(text)
    checked = cli("check", "-c", "site.toml", "--json")
    assert checked.returncode == 2
    (said,) = json.loads(checked.stdout)["errors"]
    assert said.startswith(f"site.toml: {line}")
    for secret in ("hidden", "a:secret"):
        assert secret not in checked.stdout + checked.stderr


def test_check_warns_of_addresses_that_not_every_mail_server_takes(
    tmp_path: Path, cli: Any
) -> None:
    text = SMTP.replace("twin@", "zwölf@") + MAIL.replace(
        '"a@example.com"', '"a@example.com", "jörg@example.com", "a@bücher.example"'
    )
    (tmp_path / "site.toml").write_text(text)
    done = cli("check", "-c", "site.toml")
    assert done.returncode == 0
    said = [line for line in done.stderr.splitlines() if "SMTPUTF8" in line]
    assert [line.split("'")[1] for line in said] == ["jörg@example.com", "zwölf@example.com"]
