"""Environment variables for proxies and certificates, checked before anything is sent.

httpx reads them too, but raises errors of many kinds, some only at the first request. Messages do not repeat the
values, because the URL of a proxy may contain a password.
"""

from __future__ import annotations

import ipaddress
import os
import re
import ssl
from contextlib import suppress
from urllib.request import getproxies

import httpx

from sgmethod.errors import ServerError

PORTS = {"http": 80, "https": 443}


def http_client(url: httpx.URL, headers: dict[str, str], timeout_s: float) -> httpx.Client:
    """Create an HTTP client with the environment's proxy and certificates. Raises ServerError."""
    context = _certificates()
    return httpx.Client(
        base_url=url,
        headers=headers,
        timeout=timeout_s,
        limits=httpx.Limits(max_connections=None),  # as many as the caller has threads
        verify=context,
        proxy=_proxy_for(url, context),
        trust_env=False,  # httpx checks proxies and networks that NO_PROXY makes unnecessary
    )


def _proxy_for(url: httpx.URL, context: ssl.SSLContext) -> str | None:
    """Return the URL of the proxy for a server, None to do without. Raises ServerError if it cannot be used."""
    proxies = getproxies()
    kind = url.scheme if proxies.get(url.scheme) else "all"
    proxy = proxies.get(kind)
    if not proxy or _is_exempt(url, proxies.get("no", "")):
        return None
    proxy = proxy if "://" in proxy else f"http://{proxy}"
    name = f"{kind}_proxy"
    _check_proxy(name if name in os.environ else name.upper(), proxy, context)
    return proxy


def _is_exempt(url: httpx.URL, no_proxy: str) -> bool:
    """Whether NO_PROXY lists a server: its host, a domain or a network around it (as for curl), or host and port."""
    host, port = url.host.rstrip("."), url.port or PORTS[url.scheme]
    listed = [entry.replace("[", "").replace("]", "") for entry in re.split(r"[\s,]+", no_proxy.lower())]
    if {"*", host, f"{host}:{port}"} & set(listed):
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:  # a name
        return any(f".{host}".endswith(f".{entry.strip('.')}") for entry in listed if entry)
    networks = []
    for entry in listed:
        with suppress(ValueError):
            networks.append(ipaddress.ip_network(entry, strict=False))
    return any(address in network for network in networks)


def check_host(url: httpx.URL) -> None:
    """Raise ValueError if the host is missing, or not a name that can be looked up."""
    if not url.host:
        raise ValueError("there is no host")
    url.host.encode("idna")


def _certificates() -> ssl.SSLContext:
    folders = os.environ.get("SSL_CERT_DIR")
    if folders and not any(map(os.path.isdir, folders.split(os.pathsep))):
        raise ServerError("SSL_CERT_DIR must be a folder of certificates: there is none of that name")
    try:
        return httpx.create_ssl_context()
    except OSError as error:
        # ssl sets the file's name only for errors with the key log.
        name, kind = ("SSL_CERT_FILE", "certificates") if error.filename is None else ("SSLKEYLOGFILE", "keys")
        raise ServerError(f"{name} must be a file of {kind}: {error.strerror or error}") from error


def _check_proxy(name: str, url: str, context: ssl.SSLContext) -> None:
    try:
        check_host(httpx.URL(url))
        httpx.HTTPTransport(proxy=url, verify=context).close()
    except ImportError as error:
        raise ServerError(f"{name} is a SOCKS proxy: for those, pip install 'httpx[socks]'") from error
    except (httpx.InvalidURL, ValueError):
        raise ServerError(f"{name} must be the URL of a proxy, such as http://127.0.0.1:3128") from None
