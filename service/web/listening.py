"""Binds the address of the web side."""

import errno
import socket

from service.domain.errors import TemporaryError
from service.site.configuration import SettingsError

#: What may change without a change of the configuration: another program ends, a network comes up.
_PASSING = (errno.EADDRINUSE, errno.EADDRNOTAVAIL, socket.EAI_AGAIN)


def bind(host: str, port: int) -> socket.socket:
    """Bind the address of the web side.

    Raises `TemporaryError` if the port is taken, or the machine does not have the address yet;
    names it. Raises `SettingsError` if the address cannot be used at all; names it.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # The protocol is named so that asyncio switches Nagle's algorithm off: without it every
    # request on a kept connection waits some 40 ms.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        # From now on a client waits for the service to come up instead of being refused.
        listener.listen(256)
    except (OSError, OverflowError) as error:
        listener.close()
        kind = TemporaryError if getattr(error, "errno", None) in _PASSING else SettingsError
        raise kind(
            f"service.host = {host!r}, service.port = {port}: cannot listen there "
            f"({getattr(error, 'strerror', None) or error}); expected a free port"
        ) from error
    return listener
