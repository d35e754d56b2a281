"""Makes the sender of a notification, and sends a test message."""

import ssl

from anyio import to_thread

from service.features.notifications.messages import OutgoingMessage
from service.features.notifications.sections import NotificationSection, sections_of
from service.features.notifications.sender import DeliveryError, Sender
from service.site.configuration import SettingsError
from service.site.settings import Settings


def make_sender(section: NotificationSection, settings: Settings) -> Sender:
    """Make the sender of a notification; it reads certificates.

    Raises `SettingsError` if its files or variables cannot be used; names the key.
    """
    # Imported here: a site without mail or webhooks need not load them.
    if section.kind == "webhook":
        from service.features.notifications.webhook import WebhookSender

        return WebhookSender(section, section.secret(), ssl.create_default_context())
    from service.features.notifications.mail import EmailSender

    smtp = sections_of(settings).smtp
    ca_file = None if smtp.ca_file is None else settings.path(smtp.ca_file)
    try:
        context = ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        raise SettingsError(
            f"smtp.ca_file = {str(ca_file)!r}: cannot be used ({error.strerror or error}); "
            "expected a file of PEM certificates"
        ) from error
    return EmailSender(section, smtp, context)


async def send_test(settings: Settings, section: NotificationSection, who: str) -> tuple[bool, str]:
    """Send a test message.

    Gives whether it was accepted, for one of the addresses at least, and why not or by whom not.
    Raises `SettingsError` if the notification cannot be used as it is configured.
    """
    sender = await to_thread.run_sync(make_sender, section, settings)
    try:
        return True, await sender.send(
            OutgoingMessage(section.id, (), lambda name: name, who)
        ) or ""
    except DeliveryError as error:
        return False, str(error)
    finally:
        await sender.close()
