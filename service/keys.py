"""API keys, and links that stand in for one.

A key is 192 random bits, so a plain SHA-256 of it is all that has to be kept: it can be neither guessed nor
turned back. A key's name owns the jobs that come with it.

    python -m service.keys NAME     prints a new key, and the line for SG_API_KEYS_FILE by which the service knows it
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import sys
from collections.abc import Mapping
from dataclasses import dataclass

_LINE = re.compile(r"([A-Za-z0-9_.-]{1,64}):([0-9a-f]{64})")


def parse_keys(text: str) -> dict[str, str]:
    """Names of keys by digest, from words such as name:sha256 between commas or white space; # begins a comment.

    Raises ValueError. A name may come twice with different keys, while one takes the other's place.
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
    """What is kept of a key."""
    return hashlib.sha256(key.encode()).hexdigest()


class KeyRing:
    """The keys that are known; with none at all the service is open."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = dict(names)

    def replace(self, names: Mapping[str, str]) -> bool:
        """Know these keys from now on, and no others; whether they differ from those before. names: by digest."""
        before, self._names = self._names, dict(names)
        return before != self._names

    def __bool__(self) -> bool:
        return bool(self._names)

    def owner_of(self, key: str) -> str | None:
        """The name that the key stands for. Takes as long for a wrong key as for a right one."""
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
        """HMAC-SHA256 over all three, in hexadecimal digits."""
        text = f"{self.resource}/{self.job_id}/{self.expires}"
        return hmac.new(secret.encode(), text.encode(), hashlib.sha256).hexdigest()

    def query(self, secret: str) -> str:
        """What makes a URL of the resource a link."""
        return f"expires={self.expires}&signature={self.signature(secret)}"

    def is_signed(self, secret: str, signature: str) -> bool:
        """Whether the signature is ours."""
        return hmac.compare_digest(self.signature(secret).encode(), signature.encode())


def main() -> int:
    """Make a key; exit status 2 for a name that cannot be one."""
    name = sys.argv[1] if len(sys.argv) == 2 else ""
    key = secrets.token_urlsafe(24)
    line = f"{name}:{digest(key)}"
    if _LINE.fullmatch(line) is None:
        print("usage: python -m service.keys NAME (1 to 64 letters, digits, or _ . -)", file=sys.stderr)
        return 2
    print(f"key: {key}\nline for SG_API_KEYS_FILE: {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
