"""Whether a publisher can listen where it is to."""

import errno
import socket

from service.domain.errors import TemporaryError
from service.plant.protocol import Endpoint
from service.site.configuration import SettingsError


def check_endpoint(endpoint: Endpoint) -> None:
    """Make sure that an endpoint can be listened on.

    Raises `TemporaryError` if the port is taken, or the machine does not have the address yet;
    names it. Raises `SettingsError` if it cannot be used at all; names it.
    """
    family = socket.AF_INET6 if ":" in endpoint.host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((endpoint.host, endpoint.port))
        except OSError as error:
            passing = (errno.EADDRINUSE, errno.EADDRNOTAVAIL, socket.EAI_AGAIN)
            kind = TemporaryError if error.errno in passing else SettingsError
            raise kind(
                f"{endpoint.key}: cannot listen there ({error.strerror or error}); "
                "expected a free port"
            ) from error
