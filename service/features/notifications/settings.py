"""What notifications bring to the configuration, and whether the machine has what it names."""

from typing import TYPE_CHECKING

from service.features.notifications.sections import Sections, sections_of
from service.site.configuration import SettingsError

if TYPE_CHECKING:
    from service.site.settings import Settings

__all__ = ["Sections", "check"]


def check(settings: "Settings") -> None:
    """Make sure that files and variables of all notifications can be used.

    Raises `SettingsError`: one line for each that cannot.
    """
    lines: dict[str, None] = {}
    for section in sections_of(settings).notifications:
        # Imported here: a site without notifications need not load what they need.
        from service.features.notifications.senders import make_sender

        try:
            make_sender(section, settings)
        except SettingsError as error:
            lines |= dict.fromkeys(error.lines)
    if lines:
        raise SettingsError(*lines)
