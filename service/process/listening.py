"""The socket that the web process serves."""

from __future__ import annotations

import ipaddress
import socket

from service.settings import Settings

BACKLOG = 2048  # connections that the system holds until they are accepted; clients of more try again after a second


def listen(settings: Settings) -> socket.socket:
    """A listening socket at the host and port of the settings. Raises OSError, as when the port is taken."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family, backlog=BACKLOG)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise OSError(f"SG_HOST and SG_PORT, {settings.host}:{settings.port}: {why}") from error


def url(listener: socket.socket) -> str:
    """Where the socket can be reached."""
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def is_loopback(listener: socket.socket) -> bool:
    """Whether only this machine can reach the socket."""
    return ipaddress.ip_address(listener.getsockname()[0]).is_loopback
