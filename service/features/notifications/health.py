"""What `check` warns of."""

from service.features.notifications.addresses import is_plain_address
from service.features.notifications.sections import sections_of
from service.site.settings import Settings


def warnings(settings: Settings) -> list[str]:
    """Name addresses that not every mail server takes, one line each."""
    sections = sections_of(settings)
    places = [(f"notifications.{one.id}.to", to) for one in sections.notifications for to in one.to]
    if any(one.kind == "email" for one in sections.notifications):
        places.append(("smtp.sender", sections.smtp.sender))
    return [
        f"{key} = {address!r}: only a mail server with SMTPUTF8 takes a name with other letters "
        "than those of ASCII; 'bearing-twin notifications test' shows whether yours does"
        for key, address in places
        if not is_plain_address(address)
    ]
