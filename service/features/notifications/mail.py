"""Sends messages by a mail server."""

import asyncio
import ssl
from typing import Final

import aiosmtplib

from service.features.notifications.messages import OutgoingMessage
from service.features.notifications.sections import NotificationSection, SmtpSection
from service.features.notifications.sender import ANSWER_S, WHOLE_S, DeliveryError, one_line, reason

_TEMPORARY: Final = range(400, 500)


class EmailSender:
    """One message for all addresses; what a server refuses for the time being is tried again."""

    def __init__(self, section: NotificationSection, smtp: SmtpSection, context: ssl.SSLContext):
        self._to = section.to
        self._smtp = smtp
        self._context = context
        # Of the present message: its id, and addresses that have it or have refused it for good.
        self._done: tuple[str, set[str]] = ("", set())
        self._refused: dict[str, str] = {}

    async def send(self, message: OutgoingMessage) -> str | None:
        """See `Sender`."""
        smtp, message_id = self._smtp, message.id
        if self._done[0] != message_id:
            self._done, self._refused = (message_id, set()), {}
        recipients = [one for one in self._to if one not in self._done[1]]
        password = smtp.password.get_secret_value() if smtp.password else None
        try:
            email = message.email(message_id, smtp.sender, self._to)
            async with asyncio.timeout(WHOLE_S):
                refused, _ = await aiosmtplib.send(
                    email,
                    sender=smtp.sender,
                    recipients=recipients,
                    hostname=smtp.host,
                    port=smtp.port,
                    username=smtp.username or None,
                    password=password,
                    timeout=ANSWER_S,
                    use_tls=smtp.security == "tls",
                    start_tls=smtp.security == "starttls",
                    tls_context=self._context if smtp.security != "none" else None,
                )
        except aiosmtplib.SMTPRecipientsRefused as error:
            answers = {one.recipient: (one.code, one.message) for one in error.recipients}
        except (aiosmtplib.SMTPException, OSError, TimeoutError, ValueError) as error:
            raise DeliveryError(self._line(error)) from error
        else:
            answers = {one: (answer.code, answer.message) for one, answer in refused.items()}
            self._done[1].update(one for one in recipients if one not in answers)
        return self._judge(answers)

    def _judge(self, answers: dict[str, tuple[int, str]]) -> str | None:
        """Try again what is refused for the time being; give what is refused for good."""
        deferred = {}
        for address, (code, text) in answers.items():
            line = f"{address}: {code} {one_line(text)}"
            if code in _TEMPORARY:
                deferred[address] = line
            else:
                self._refused[address] = line
                self._done[1].add(address)
        if deferred:
            raise DeliveryError(self._hidden("; ".join(deferred.values())))
        if len(self._refused) == len(self._to):
            # No address has it: one that is corrected gets it.
            self._done = ("", set())
            raise DeliveryError(self._hidden("; ".join(self._refused.values())))
        return self._hidden("; ".join(self._refused.values())) or None

    async def close(self) -> None:
        """Nothing is kept open."""

    def _line(self, error: Exception) -> str:
        return self._hidden(f"{self._smtp.host}:{self._smtp.port}: {reason(error)}")

    def _hidden(self, text: str) -> str:
        password = self._smtp.password.get_secret_value() if self._smtp.password else ""
        return one_line(text.replace(password, "***") if password else text)
