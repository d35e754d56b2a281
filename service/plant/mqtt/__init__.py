"""Tags and alarms to an MQTT broker (extra ``mqtt``)."""

import ssl

from service.plant.protocol import Publisher, PublisherEntry
from service.site.configuration import SettingsError
from service.site.settings import MqttSection, Settings

PERIOD_S = 1.0


def _make(settings: Settings) -> Publisher:
    from service.plant.mqtt.publisher import MqttPublisher

    return MqttPublisher(_section(settings))


def _check(settings: Settings) -> None:
    ca_file = _section(settings).ca_file
    try:
        ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        raise SettingsError(
            f"mqtt.ca_file = {str(ca_file)!r}: cannot be used ({error.strerror or error}); "
            "expected a file of PEM certificates"
        ) from error


def _section(settings: Settings) -> MqttSection:
    section = settings.mqtt
    if section.ca_file is None:
        return section
    return section.model_copy(update={"ca_file": settings.path(section.ca_file)})


PUBLISHER = PublisherEntry(
    name="mqtt",
    package="aiomqtt",
    period_s=PERIOD_S,
    is_enabled=lambda settings: settings.mqtt.enabled,
    make=_make,
    check=_check,
)
