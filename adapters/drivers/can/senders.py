"""Who sends a message whose identifier is not wholly given.

J1939 modules of one kind send the same parameter group, and only the sender's address in the
identifier says which one it is. The address of a module may differ from that in the DBC file, so
any sender is taken as long as there is only one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from cantools.database.can import Message

from adapters.samples import Quality

ALL_IDENTIFIER_BITS = 0x1FFFFFFF
# J1939-21: priority (3 bits), data pages (2), format (8), specific (8), sender (8). From format F0
# on the specific byte belongs to the parameter group number, below it is the addressee.
FIRST_J1939_BROADCAST_FORMAT = 0xF0
J1939_BROADCAST_MASK = 0x03FFFF00
J1939_ADDRESSED_MASK = 0x03FF0000
J1939_SENDER_MASK = 0xFF
J1939_ALL_BUT_PRIORITY = 0x03FFFFFF
ANY_SENDER = 0xFE  # J1939's null address; in a DBC file: any sender

MOST_SENDERS = 256
#: Process time for which one listens before a sender that the file does not name is taken.
SETTLE_US = 2_000_000


@dataclass(slots=True)
class Senders:
    """Those that were heard, since the start: one that is silent may come back.

    - ``own``: the sender that the DBC file names; None when it names none.
    - ``mask``: the bits of the identifier that name the sender.
    - ``asked_for``: the channel's ``frame_id_mask`` takes all of them.
    """

    own: int | None
    mask: int
    asked_for: bool
    heard: dict[int, None] = field(default_factory=dict)
    first_us: int = 0
    settle_us: int = SETTLE_US

    def judge(self, frame_id: int, now_us: int) -> Quality | None:
        """Return the best quality that a frame's values can have; None for another's frame."""
        sender = frame_id & self.mask
        if sender not in self.heard and len(self.heard) < MOST_SENDERS:
            self.heard[sender] = None
        self.first_us = self.first_us or now_us
        if self.asked_for or sender == self.own:
            return Quality.GOOD
        if self.own in self.heard:
            return None
        if len(self.heard) > 1:
            return Quality.UNCERTAIN
        settled = self.is_settled(now_us)
        return Quality.GOOD if settled else Quality.WAITING_FOR_INITIAL_DATA

    def is_settled(self, now_us: int) -> bool:
        """Whether one has listened for long enough to have heard the others."""
        return self.first_us > 0 and not 0 <= now_us - self.first_us < self.settle_us

    def note(self) -> str:
        """Say what is to be known of them; empty when there is nothing."""
        if len(self.heard) < 2:
            return ""
        heard = ", ".join(f"{sender:#x}" for sender in self.heard)
        if self.asked_for:
            return f"comes under several identifiers ({heard}), its frame_id_mask takes all"
        if self.own in self.heard:
            return (
                f"has several senders ({heard}), only that of the DBC file ({self.own:#x}) counts"
            )
        return (
            f"has several senders ({heard}); enter the right one in the DBC file, or give the "
            "channel a frame_id_mask"
        )


def senders(message: Message, mask: int, *, asked_for: bool) -> Senders | None:
    """Return who may send a message with this mask; None when the identifier is wholly given."""
    if is_j1939(message):
        if mask & J1939_SENDER_MASK == J1939_SENDER_MASK:
            return None
        address = message.frame_id & J1939_SENDER_MASK
        return Senders(None if address == ANY_SENDER else address, J1939_SENDER_MASK, asked_for)
    if mask == ALL_IDENTIFIER_BITS:
        return None
    return Senders(message.frame_id, ALL_IDENTIFIER_BITS, asked_for)


def is_j1939(message: Message) -> bool:
    """Whether the file calls it a J1939 parameter group."""
    return message.protocol == "j1939" and message.is_extended_frame


def group_mask(message: Message) -> int:
    """Bits of the identifier that name a message: for J1939 neither priority nor sender."""
    if not is_j1939(message):
        return ALL_IDENTIFIER_BITS
    to_all = (message.frame_id >> 16 & 0xFF) >= FIRST_J1939_BROADCAST_FORMAT
    return J1939_BROADCAST_MASK if to_all else J1939_ADDRESSED_MASK


def identifier_mask(message: Message, others: Sequence[Message]) -> int:
    """Fewest bits of the identifier in which a message differs from the others of its group.

    One that the file gives to any sender keeps its group: the others are looked for first.
    """
    mask = group_mask(message)
    wider = (mask | J1939_SENDER_MASK, J1939_ALL_BUT_PRIORITY, ALL_IDENTIFIER_BITS)
    if message.frame_id & J1939_SENDER_MASK == ANY_SENDER:
        others = [one for one in others if one.frame_id & J1939_SENDER_MASK == ANY_SENDER]
        wider = (J1939_BROADCAST_MASK, ALL_IDENTIFIER_BITS & ~J1939_SENDER_MASK, mask)
    for candidate in (mask, *wider):
        if all((one.frame_id ^ message.frame_id) & candidate for one in others):
            return candidate
    return mask
