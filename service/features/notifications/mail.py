"""Sends messages by a mail server."""

import asyncio
import ssl
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
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
    PostponedError,
    one_line,
    reason,
)

_TEMPORARY: Final = range(400, 500)
_TOO_LARGE: Final = 552
_NO_ROOM: Final = 452  # also the answer to a size (RFC 1870)
_CLOSING: Final = 421
_NO_SMTPUTF8: Final = (553, "the mail server takes no such name (it has no SMTPUTF8)")
_FAILED: Final = 450  # in place of an answer that did not come
#: Times that an address is refused for the time being until the others wait for it no longer.
_PATIENCE: Final = 9
#: Events of which it is known to whom they went; more than can wait while an address lacks them.
_EVENTS: Final = 50_000


@dataclass(slots=True)
class _Delivery:
    """What became of a message.

    - ``done``: addresses that have it, and those that are refused for good, with what was said.
    - ``is_for_its_text``: whether the message was refused, not an address.
    """

    done: dict[str, str]
    is_for_its_text: bool = False

    @property
    def is_taken(self) -> bool:
        """Whether an address has it."""
        return "" in self.done.values()

    @property
    def refused(self) -> str:
        """What was said of the addresses that are refused for good."""
        return "; ".join(filter(None, self.done.values()))


class EmailSender:
    """One message for all addresses; what a server refuses for the time being is tried again."""

    def __init__(self, section: NotificationSection, smtp: SmtpSection, context: ssl.SSLContext):
        self._to = section.to
        self._smtp = smtp
        self._context = context
        # By event: until all addresses are done, it may come again with others.
        self._done: dict[str, dict[str, str]] = {}
        # How often an address was refused for the time being since it was accepted.
        self._deferrals: Counter[str] = Counter()

    async def send(self, message: OutgoingMessage) -> str | None:
        """See `Sender`."""
        events = message.event_ids
        is_again = any(one in self._done for one in events)
        first, *others = [self._done.get(one, {}) for one in events] or [{}]
        delivery = _Delivery(
            {to: line for to, line in first.items() if all(to in other for other in others)}
        )
        try:
            async with self._client() as client:
                answers = await self._send_to_all(client, message, delivery)
        except (aiosmtplib.SMTPException, OSError, TimeoutError, ValueError) as error:
            line = self._line(error)
            if _may_be_for_its_size(error):
                raise PostponedError(line) from error
            raise DeliveryError(line, is_partial=delivery.is_taken) from error
        else:
            deferred = self._judge(answers, delivery, is_again=is_again)
        finally:
            for event in events if delivery.is_taken else ():
                self._done.setdefault(event, {}).update(delivery.done)
            for event in list(self._done)[:-_EVENTS]:
                del self._done[event]
        if deferred:
            text = self._hidden("; ".join(deferred))
            raise DeliveryError(text, is_partial=delivery.is_taken)
        line = self._hidden(delivery.refused)
        if not delivery.is_taken:  # an address that is corrected gets it
            if delivery.is_for_its_text:
                raise ContentRefusedError(line, is_final=True)
            raise DeliveryError(line)
        for event in events:
            self._done.pop(event, None)
        return line or None

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
        left = [one for one in self._to if one not in delivery.done]
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
                if not delivery.is_taken and (not plain or _may_be_for_its_size(error)):
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
                # What others have is not too large: it counts as said of these addresses.
                if not (delivery.is_taken and _may_be_for_its_size(error)):
                    raise
            else:
                delivery.is_for_its_text = True
            return dict.fromkeys(group, (error.code, error.message))
        answers = {named[one]: (answer.code, answer.message) for one, answer in refused.items()}
        taken = {one for one in group if one not in answers}
        delivery.done |= dict.fromkeys(taken, "")
        for address in taken:
            del self._deferrals[address]
        return answers

    def _judge(
        self, answers: dict[str, tuple[int, str]], delivery: _Delivery, *, is_again: bool
    ) -> list[str]:
        """Note what is refused for good; give what is refused for the time being.

        ``is_again``: whether the message came before. New ones that come fast use up no patience.
        """
        deferred = []
        for address, (code, text) in answers.items():
            line = f"{address}: {code} {one_line(text)}"
            if code not in _TEMPORARY:
                delivery.done[address] = line
                continue
            if is_again or not self._deferrals[address]:
                self._deferrals[address] += delivery.is_taken
            if delivery.is_taken and self._deferrals[address] >= _PATIENCE:
                delivery.done[address] = line  # the others wait for their next message
            else:
                deferred.append(line)
        return deferred

    async def close(self) -> None:
        """Nothing is kept open."""

    def _line(self, error: Exception) -> str:
        return self._hidden(f"{self._smtp.host}:{self._smtp.port}: {reason(error)}")

    def _hidden(self, text: str) -> str:
        password = self._smtp.password.get_secret_value() if self._smtp.password else ""
        return one_line(text.replace(password, "***") if password else text)


def _may_be_for_its_size(error: Exception) -> bool:
    """Whether a server postponed a message, not the connection, for what may be its size."""
    if isinstance(error, aiosmtplib.SMTPSenderRefused):
        return error.code == _NO_ROOM
    return isinstance(error, aiosmtplib.SMTPDataError) and error.code != _CLOSING
