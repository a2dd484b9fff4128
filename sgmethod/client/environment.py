"""Environment variables for proxies and certificates, checked before anything is sent.

httpx reads them too, but raises errors of many kinds, some only at the first request. Messages do not repeat the
values, because the URL of a proxy may contain a password.
"""

from __future__ import annotations

import os
import ssl

import httpx

from sgmethod.errors import ServerError

PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY")  # or in lower case


def http_client(url: httpx.URL, headers: dict[str, str], timeout_s: float) -> httpx.Client:
    """Create an HTTP client with the environment's proxies and certificates. Raises ServerError."""
    context = _certificates()
    for name, value in os.environ.items():
        if name.upper() in PROXIES and value:
            _check_proxy(name, value if "://" in value else f"http://{value}", context)
    try:
        many = httpx.Limits(max_connections=None)  # as many as the caller has threads
        return httpx.Client(base_url=url, headers=headers, timeout=timeout_s, limits=many, verify=context)
    except httpx.InvalidURL as error:  # the other variables have been checked above
        raise ServerError(f"NO_PROXY must be a list of hosts, separated by commas: {error}") from error


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
