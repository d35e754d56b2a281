"""Recipients of notifications: sections `[smtp]` and `[[notifications]]` of the configuration."""

import base64
import binascii
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self, cast
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, Field, SecretStr, model_validator

from adapters.configuration import first_repeated
from service.domain.daily_hours import DailyHours
from service.domain.section import Section
from service.features.notifications.addresses import sent_address
from service.site.configuration import SettingsError

if TYPE_CHECKING:
    from service.site.settings import Settings

Priority = Annotated[int, Field(ge=1, le=3)]
_ADDRESS = r"^[^@\s,;<>\"]+@[^@\s,;<>\"]+$"


def _address(text: str) -> str:
    try:
        sent_address(text)
    except ValueError as error:
        raise ValueError(f"the domain is none: {error}") from error
    return text


Address = Annotated[str, Field(pattern=_ADDRESS, max_length=254), AfterValidator(_address)]
#: What the Standard Webhooks specification asks of a key.
_SECRET_BYTES = (24, 64)
_SECRET_PREFIX = "whsec_"


class SmtpSection(Section):
    """The mail server that takes the messages; the password is better in the environment."""

    host: str = ""
    port: int = Field(587, ge=1, le=65535)
    #: `starttls` (port 587), `tls` from the first byte (port 465), or `none`.
    security: Literal["starttls", "tls", "none"] = "starttls"
    username: str = ""
    password: SecretStr | None = None
    #: The address that messages come from.
    sender: Annotated[str, Field(pattern=f"^$|{_ADDRESS}"), AfterValidator(_address)] = ""
    #: Certificates of the authority that signed the server's; without it the machine's own.
    ca_file: Path | None = None

    @model_validator(mode="after")
    def _password_is_hidden(self) -> Self:
        if self.username and self.security == "none":
            raise ValueError(
                "security = 'none' with a username: everybody on the way reads the password; "
                "expected 'starttls' or 'tls'"
            )
        return self


class QuietHours(DailyHours):
    """When low priorities are held back; alarms that are still active are sent at the end."""

    priorities: tuple[Annotated[int, Field(ge=2, le=3)], ...] = (2, 3)


class Escalation(Section):
    """Further recipients of an alarm that is not acknowledged so many minutes after it was sent."""

    after_min: float = Field(gt=0, le=10_080)
    #: Another notification.
    to: str


def _url(text: str) -> str:
    try:
        place = urlsplit(text)
        fits = place.scheme in ("http", "https") and bool(place.hostname) and place.port != 0
        fits = fits and place.username is None
    except ValueError:
        fits = False
    if not fits:
        raise ValueError("expected https://HOST/PATH or http://HOST/PATH, without a password")
    return text


class NotificationSection(Section):
    """One recipient of messages about alarms."""

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")
    kind: Literal["email", "webhook"]
    #: Of e-mail.
    to: tuple[Address, ...] = ()
    #: Of a webhook, and the environment variable that has the key of its signature.
    url: Annotated[str, AfterValidator(_url)] | None = Field(None, repr=False)
    secret_variable: str = ""
    #: Alarms of these priorities; of these assets and families, or of all.
    priorities: tuple[Priority, ...] = Field((1, 2, 3), min_length=1)
    assets: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    #: Sends only what another notification escalates to it.
    only_escalations: bool = False
    quiet_hours: QuietHours | None = None
    escalation: tuple[Escalation, ...] = ()
    #: Wall seconds between two messages at least; priority 1 does not wait for it.
    interval_s: float = Field(60, ge=0, le=86_400)

    @model_validator(mode="after")
    def _kind_has_its_keys(self) -> Self:
        if self.kind == "email":
            if not self.to:
                raise ValueError("to: missing; expected the addresses of an e-mail")
            if self.url or self.secret_variable:
                raise ValueError("url and secret_variable: expected with kind = 'webhook' only")
        elif self.url is None:
            raise ValueError("url: missing; expected the address of a webhook")
        elif self.to:
            raise ValueError("to: expected with kind = 'email' only")
        minutes = [step.after_min for step in self.escalation]
        if minutes != sorted(minutes):
            raise ValueError(f"escalation: after_min {minutes}; expected them in rising order")
        return self

    @property
    def receivers(self) -> tuple[str, ...]:
        """Addresses, or the host of a webhook: the rest of its address may be a secret."""
        if self.url is None:
            return self.to
        return (urlsplit(self.url).netloc,)

    def secret(self) -> bytes | None:
        """Read the key of the signature from the environment; None where none is asked for.

        Raises `SettingsError` if the variable has none; never shows its value.
        """
        name = self.secret_variable
        if not name:
            return None
        where = f"notifications.{self.id}.secret_variable = {name!r}"
        text = os.environ.get(name, "")
        if not text:
            raise SettingsError(f"{where}: the environment has no such variable")
        try:
            key = base64.b64decode(text.removeprefix(_SECRET_PREFIX), validate=True)
        except binascii.Error:
            key = b""
        least, most = _SECRET_BYTES
        if not least <= len(key) <= most:
            raise SettingsError(
                f"{where}: expected {least} to {most} random bytes in base64, as "
                "'openssl rand -base64 32' prints them"
            )
        return key


class Sections(BaseModel):
    """What the configuration says of notifications."""

    smtp: SmtpSection = SmtpSection()
    notifications: tuple[NotificationSection, ...] = ()

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        notifications, smtp = self.notifications, self.smtp
        twice = first_repeated(one.id for one in notifications)
        if twice is not None:
            raise ValueError(f"notifications: the id {twice!r} is used twice; expected unique")
        ids = {one.id for one in notifications}
        for one in notifications:
            for step in one.escalation:
                if step.to not in ids or step.to == one.id:
                    raise ValueError(
                        f"notifications.{one.id}.escalation.to = {step.to!r}: expected the id of "
                        "another notification"
                    )
            if one.kind == "email" and not (smtp.host and smtp.sender):
                missing = "sender" if smtp.host else "host"
                raise ValueError(f"smtp.{missing}: missing; notification {one.id!r} needs it")
        return self


def sections_of(settings: "Settings") -> Sections:
    """Give the sections of a configuration."""
    return cast(Sections, settings)
