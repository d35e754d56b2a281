"""Sends messages by a mail server."""

import asyncio
import ssl
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

import aiosmtplib

from service.features.notifications.addresses import is_plain_address, sent_address
from service.features.notifications.messages import OutgoingMessage
from service.features.notifications.sections import NotificationSection, SmtpSection
from service.features.notifications.sender import (
    ANSWER_S,
    WHOLE_S,
    ContentRefusedError,
    DeliveryError,
    one_line,
    reason,
)

_TEMPORARY: Final = range(400, 500)
_TOO_LARGE: Final = 552
_NO_SMTPUTF8: Final = (553, "the mail server takes no such name (it has no SMTPUTF8)")
_FAILED: Final = 450  # in place of an answer that did not come
#: Times that an address is refused for the time being until the others wait for it no longer.
_PATIENCE: Final = 9
# Of which it is known who has them.
_EVENTS: Final = 2000
_MESSAGES: Final = 4


@dataclass(slots=True)
class _Delivery:
    """What became of a message.

    - ``taken``: addresses that have it.
    - ``refused``: what was said of addresses that are refused for good.
    - ``is_for_its_text``: whether the message was, not an address.
    """

    taken: set[str] = field(default_factory=set)
    refused: dict[str, str] = field(default_factory=dict)
    is_for_its_text: bool = False


class EmailSender:
    """One message for all addresses; what a server refuses for the time being is tried again."""

    def __init__(self, section: NotificationSection, smtp: SmtpSection, context: ssl.SSLContext):
        self._to = section.to
        self._smtp = smtp
        self._context = context
        # By id: one that is urgent may go out between two tries of another.
        self._deliveries: dict[str, _Delivery] = {}
        # Addresses that have an event: it may come again in another message.
        self._have: dict[str, set[str]] = {}
        # How often an address was refused for the time being since it was accepted.
        self._deferrals: Counter[str] = Counter()

    async def send(self, message: OutgoingMessage) -> str | None:
        """See `Sender`."""
        message_id = message.id
        delivery = self._deliveries.setdefault(message_id, _Delivery())
        for forgotten in list(self._deliveries)[:-_MESSAGES]:
            del self._deliveries[forgotten]
        events = message.event_ids
        if events:
            delivery.taken |= set.intersection(*(self._have.get(one, set()) for one in events))
        try:
            async with self._client() as client:
                answers = await self._send_to_all(client, message, delivery)
        except (aiosmtplib.SMTPException, OSError, TimeoutError, ValueError) as error:
            raise DeliveryError(self._line(error)) from error
        finally:
            for event in events if delivery.taken else ():
                self._have.setdefault(event, set()).update(delivery.taken)
        try:
            line = self._judge(answers, delivery)
        finally:
            if not delivery.taken:  # nothing is known but who is refused, and that may change
                del self._deliveries[message_id]
        del self._deliveries[message_id]
        for event in events:
            self._have.pop(event, None)
        for event in list(self._have)[:-_EVENTS]:
            del self._have[event]
        return line

    def _client(self) -> aiosmtplib.SMTP:
        smtp = self._smtp
        return aiosmtplib.SMTP(
            hostname=smtp.host,
            port=smtp.port,
            username=smtp.username or None,
            password=smtp.password.get_secret_value() if smtp.password else None,
            timeout=ANSWER_S,
            use_tls=smtp.security == "tls",
            start_tls=smtp.security == "starttls",
            tls_context=self._context if smtp.security != "none" else None,
        )

    async def _send_to_all(
        self, client: aiosmtplib.SMTP, message: OutgoingMessage, delivery: _Delivery
    ) -> dict[str, tuple[int, str]]:
        """Send to all who do not have it; gives code and text for those that are refused."""
        left = [one for one in self._to if one not in delivery.taken | delivery.refused.keys()]
        plain = [one for one in left if is_plain_address(one)]
        others = [one for one in left if one not in plain]
        answers: dict[str, tuple[int, str]] = {}
        if plain:  # every server takes them
            async with asyncio.timeout(WHOLE_S):
                answers = await self._send_to(client, message, plain, delivery)
        if others:
            try:
                async with asyncio.timeout(WHOLE_S):
                    answers |= await self._send_to(client, message, others, delivery)
            except (aiosmtplib.SMTPException, OSError, TimeoutError, ValueError) as error:
                if not (plain or delivery.taken):
                    raise
                answer = (getattr(error, "code", _FAILED), reason(error))
                answers |= dict.fromkeys(others, answer)
        return answers

    async def _send_to(
        self,
        client: aiosmtplib.SMTP,
        message: OutgoingMessage,
        group: Sequence[str],
        delivery: _Delivery,
    ) -> dict[str, tuple[int, str]]:
        """Send to addresses that are all plain, or none of them."""
        are_plain = is_plain_address(group[0])
        if not are_plain:
            if client.is_ehlo_or_helo_needed:
                with suppress(aiosmtplib.SMTPHeloError):
                    await client.ehlo()
            if not client.supports_extension("smtputf8"):
                return dict.fromkeys(group, _NO_SMTPUTF8)
        sender = sent_address(self._smtp.sender)
        named = {sent_address(one): one for one in group}
        shown = [sent_address(one) for one in self._to if is_plain_address(one) or not are_plain]
        email = message.email(message.id, sender, shown)
        try:
            refused, _ = await client.send_message(email, sender=sender, recipients=list(named))
        except aiosmtplib.SMTPRecipientsRefused as error:
            return {named[one.recipient]: (one.code, one.message) for one in error.recipients}
        except (aiosmtplib.SMTPDataError, aiosmtplib.SMTPSenderRefused) as error:
            is_sender = isinstance(error, aiosmtplib.SMTPSenderRefused)
            if error.code in _TEMPORARY or (is_sender and error.code != _TOO_LARGE):
                raise
            delivery.is_for_its_text = True
            return dict.fromkeys(group, (error.code, error.message))
        answers = {named[one]: (answer.code, answer.message) for one, answer in refused.items()}
        taken = {one for one in group if one not in answers}
        delivery.taken |= taken
        for address in taken:
            del self._deferrals[address]
        return answers

    def _judge(self, answers: dict[str, tuple[int, str]], delivery: _Delivery) -> str | None:
        """Try again what is refused for the time being; give what is refused for good."""
        deferred = {}
        for address, (code, text) in answers.items():
            line = f"{address}: {code} {one_line(text)}"
            if code not in _TEMPORARY:
                delivery.refused[address] = line
                continue
            self._deferrals[address] += bool(delivery.taken)
            if delivery.taken and self._deferrals[address] >= _PATIENCE:
                delivery.refused[address] = line  # the others wait for their next message
            else:
                deferred[address] = line
        if deferred:
            raise DeliveryError(self._hidden("; ".join(deferred.values())))
        line = self._hidden("; ".join(delivery.refused.values()))
        if not delivery.taken:
            # No address has it: one that is corrected gets it.
            if delivery.is_for_its_text:
                raise ContentRefusedError(line, is_final=True)
            raise DeliveryError(line)
        return line or None

    async def close(self) -> None:
        """Nothing is kept open."""

    def _line(self, error: Exception) -> str:
        return self._hidden(f"{self._smtp.host}:{self._smtp.port}: {reason(error)}")

    def _hidden(self, text: str) -> str:
        password = self._smtp.password.get_secret_value() if self._smtp.password else ""
        return one_line(text.replace(password, "***") if password else text)
