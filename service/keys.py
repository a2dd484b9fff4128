"""API keys, and links that work without a key.

A key is 192 random bits, so storing its plain SHA-256 is safe: it can be neither guessed nor reversed. A key's name
owns the jobs that are submitted with it.

    python -m service.keys NAME     prints a new key, and its line for SG_API_KEYS_FILE
"""

from __future__ import annotations

import argparse
import hashlib
import hmac
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass

_LINE = re.compile(r"([A-Za-z0-9_.-]{1,64}):([0-9a-f]{64})")


def parse_keys(text: str) -> dict[str, str]:
    """Parse words such as name:sha256, separated by commas or white space; # begins a comment. Returns names by digest.

    Raises ValueError. A name may occur twice with different keys, while one replaces the other.
    """
    words = " ".join(line.partition("#")[0] for line in text.splitlines()).replace(",", " ").split()
    keys: dict[str, str] = {}
    for number, word in enumerate(words, 1):
        match = _LINE.fullmatch(word)
        if match is None:
            raise ValueError(f"key {number} must be a name, a colon and 64 hex digits (SHA-256)")
        keys[match[2]] = match[1]
    return keys


def digest(key: str) -> str:
    """Hash a key for storage."""
    return hashlib.sha256(key.encode()).hexdigest()


class KeyRing:
    """The known keys; without any, the service is open."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = dict(names)

    def replace(self, names: Mapping[str, str]) -> bool:
        """Replace all keys, and return whether they changed. names: by digest."""
        before, self._names = self._names, dict(names)
        return before != self._names

    def __bool__(self) -> bool:
        return bool(self._names)

    def owner_of(self, key: str) -> str | None:
        """Return the owner of the key, else None. It takes as long for a wrong key as for a right one."""
        presented = digest(key)
        owner = None
        for known, name in self._names.items():
            if hmac.compare_digest(known, presented):
                owner = name
        return owner


@dataclass(frozen=True)
class Link:
    """The right to GET one resource ("decode" or "bitstreams") of one job until a time (seconds since 1970)."""

    resource: str
    job_id: str
    expires: int

    def signature(self, secret: str) -> str:
        """Return the HMAC-SHA256 over all three fields, in hexadecimal."""
        text = f"{self.resource}/{self.job_id}/{self.expires}"
        return hmac.new(secret.encode(), text.encode(), hashlib.sha256).hexdigest()

    def query(self, secret: str) -> str:
        """Return the query parameters that make a URL of the resource a link."""
        return f"expires={self.expires}&signature={self.signature(secret)}"

    def is_signed(self, secret: str, signature: str) -> bool:
        return hmac.compare_digest(self.signature(secret).encode(), signature.encode())


def main() -> None:
    """Print a new key."""
    parser = argparse.ArgumentParser(prog="python -m service.keys", description=main.__doc__)
    parser.add_argument("name", metavar="NAME", help="owner of the key; 1 to 64 letters, digits, or _ . -")
    key = secrets.token_urlsafe(24)
    line = f"{parser.parse_args().name}:{digest(key)}"
    if _LINE.fullmatch(line) is None:
        parser.error("NAME must be 1 to 64 letters, digits, or _ . -")
    print(f"key: {key}\nline for SG_API_KEYS_FILE: {line}")


if __name__ == "__main__":
    main()
