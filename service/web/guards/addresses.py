"""Addresses of clients, as limits count them."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence

NETWORK_BITS = 64  # of an IPv6 address: one customer has at least as many as the rest can tell apart
UNKNOWN = "unknown"


def address_of(peer: Sequence[object] | None) -> str:
    """Who a peer (host, port) is: an IPv4 address or an IPv6 network."""
    try:
        address = ipaddress.ip_address(str(peer[0])) if peer else None
    except ValueError:
        address = None
    if isinstance(address, ipaddress.IPv6Address):
        mapped = address.ipv4_mapped
        address = mapped or ipaddress.ip_network((int(address), NETWORK_BITS), strict=False).network_address
    return UNKNOWN if address is None else str(address)
