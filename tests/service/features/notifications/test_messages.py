"""What a message says, without any server."""

from dataclasses import replace

from alarm_bench import STORED

from service.features.notifications.messages import Item, OutgoingMessage
from service.features.notifications.tables import Notification


def test_a_name_that_was_stored_before_sends_no_control_character() -> None:
    alarm = replace(STORED, message="hot\r\nBcc: x@example.com")
    item = Item(Notification("mail", alarm), ("raised:1",))
    sent = OutgoingMessage("mail", [item], lambda _: "Pump\x1b[31m\u202e 3\x9b\r\nBcc: y")
    message = sent.email("1", "twin@example.com", ["a@example.com"])
    assert str(message["Subject"]) == (
        "Bearing Twin: raised: Pump [31m 3 Bcc: y, hot Bcc: x@example.com"
    )
    text = message.get_payload(decode=True)
    assert isinstance(text, bytes)
    assert text.decode().startswith("RAISED  Pump [31m  3   Bcc: y (")
    assert not set("\x1b\x9b\u202e\r") & set(text.decode())
