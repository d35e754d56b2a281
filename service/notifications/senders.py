"""Makes the sender of a notification."""

import ssl

from service.notifications.sender import Sender
from service.site.configuration import SettingsError
from service.site.notification_section import NotificationSection
from service.site.settings import Settings


def check_senders(settings: Settings) -> None:
    """Make sure that files and variables of all notifications can be used.

    Raises
    ------
    SettingsError
        One line for each that cannot.
    """
    lines: dict[str, None] = {}
    for section in settings.notifications:
        try:
            make_sender(section, settings)
        except SettingsError as error:
            lines |= dict.fromkeys(error.lines)
    if lines:
        raise SettingsError(*lines)


def make_sender(section: NotificationSection, settings: Settings) -> Sender:
    """Make the sender of a notification; it reads certificates.

    Raises
    ------
    SettingsError
        If its files or variables cannot be used; names the key.
    """
    # Imported here: a site that tells nobody need not load them.
    if section.kind == "webhook":
        from service.notifications.webhook import WebhookSender

        return WebhookSender(section, section.secret(), ssl.create_default_context())
    from service.notifications.mail import EmailSender

    smtp = settings.smtp
    ca_file = None if smtp.ca_file is None else settings.path(smtp.ca_file)
    try:
        context = ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        raise SettingsError(
            f"smtp.ca_file = {str(ca_file)!r}: cannot be used ({error.strerror or error}); "
            "expected a file of PEM certificates"
        ) from error
    return EmailSender(section, smtp, context)
