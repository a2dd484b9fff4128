"""Every setting of the service with its unit, default and range.

Settings come from environment variables named SG_ and the field's name in capitals. docs/deploy.md has the same table;
a test compares the two.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from functools import cached_property
from ipaddress import ip_network
from pathlib import Path
from typing import ClassVar
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.keys import parse_keys
from sgmethod.io.image import ImageLimits
from sgmethod.native import native
from sgmethod.threads import MAX_THREADS

MIN_SECRET_LENGTH = 32
MIN_WEBHOOK_KEY_BYTES = 24  # as Standard Webhooks has it
LONGEST_S = 86_400.0  # small enough for the system and both databases
LONGEST_KEPT_S = 100 * 365 * 86_400.0  # so that the expiry is a valid date
MAX_WORKERS = 64  # processes of one machine
MIN_FREE_UPLOADS = 4  # with less space than this many of the largest uploads, the disk counts as full
OTHER_NAMES = frozenset({"SG_API_KEY", "SG_THREADS"})  # the client's, and the kernels'


def default_workers() -> int:
    """Return one worker for every four cores: an encode gains little beyond four threads."""
    return min(max(1, native.available_cores() // 4), MAX_WORKERS)


def listed(text: str) -> list[str]:
    """Split a setting at its commas."""
    return list(filter(None, map(str.strip, text.split(","))))


def unknown_settings(names: Iterable[str]) -> list[str]:
    """Return the names that look like settings but are not, such as misspelt ones."""
    known = {f"SG_{field}".upper() for field in Settings.model_fields} | OTHER_NAMES
    return sorted(name for name in names if name.startswith("SG_") and name not in known)


class Settings(BaseSettings):
    """The operator's settings, checked once at the start."""

    # One value suits everybody.
    max_streams: ClassVar[int] = 200
    max_waiting_decodes: ClassVar[int] = 64

    model_config = SettingsConfigDict(env_prefix="SG_", env_ignore_empty=True, frozen=True, allow_inf_nan=False)

    # The ten that most services need.
    host: str = Field(default="127.0.0.1", description="address to listen on")
    port: int = Field(default=8000, ge=0, le=65535, description="TCP port; 0 takes a free one")
    data_dir: Path = Field(default=Path("data"), description="folder for the job table, sources and bitstreams")
    workers: int = Field(
        default_factory=default_workers, ge=1, le=MAX_WORKERS, description="number of concurrent encodes"
    )
    api_keys_file: Path | None = Field(
        default=None, description="file of API keys, one name:SHA-256 per line; without keys the service is open to all"
    )
    trusted_proxies: str = Field(
        default="", description="addresses and networks, separated by commas, whose X-Forwarded-For is trusted"
    )
    retention_s: float = Field(
        default=30 * 86_400, ge=0, le=LONGEST_KEPT_S, description="seconds until finished jobs are removed; 0 for never"
    )
    quota_bytes: int = Field(
        default=0, ge=0, description="bytes of all images and bitstreams before new jobs get 429; 0 for no limit"
    )
    database_url: str = Field(
        default="",
        pattern=r"^(|sqlite|postgres(ql)?://.*)$",
        repr=False,  # it may hold a password
        description="job table: empty or `sqlite` for a file in the data folder, or postgresql://...",
    )
    storage_url: str = Field(
        default="",
        pattern=r"^(|s3://[A-Za-z0-9._-]+(/[^?#\s]*)?)$",
        description="sources and bitstreams: empty for the data folder, or s3://bucket/prefix",
    )

    # Jobs and encodes.
    queue_length: int = Field(
        default=1000, ge=1, description="queued jobs before new ones get 429; one API key may have half of them"
    )
    max_time_limit_s: float = Field(
        default=300.0,
        gt=0,
        le=LONGEST_S,
        description="seconds, the longest and default time limit of an encode; one that takes twice as long is killed",
    )
    job_memory_bytes: int = Field(
        default=8 * 2**30, ge=2**28, le=2**62, description="maximum bytes of memory per encode; a decode has a quarter"
    )
    lease_s: float = Field(
        default=15.0,
        ge=1,
        le=LONGEST_S,
        description="seconds until the job of a lost worker goes to another; jobs that wait for four times as long "
        "without a report from any worker make /readyz fail",
    )
    stop_grace_s: float = Field(
        default=10.0, gt=0, le=LONGEST_S, description="seconds allowed for stopping before processes are killed"
    )

    require_sandbox: bool = Field(
        default=False, description="refuse to start where the system cannot confine processes that read uploads"
    )

    # Retention and quotas.
    source_retention_s: float = Field(
        default=3600.0,
        ge=0,
        le=LONGEST_KEPT_S,
        description="seconds to keep the image of a finished job for re-encoding; 0 to delete it at once",
    )
    quota_bytes_per_key: int = Field(
        default=0,
        ge=0,
        description="bytes of the images and bitstreams of one API key before its new jobs get 429; 0 for no limit",
    )

    # Links and webhooks.
    link_secret: SecretStr = Field(
        default=SecretStr(""), description="at least 32 characters that sign links; empty disables links"
    )
    webhook_urls: str = Field(
        default="",
        pattern=r"^(|https?://[^/,\s][^,\s]*(,\s*https?://[^/,\s][^,\s]*)*)$",
        repr=False,
        description="addresses, separated by commas, that receive a webhook when a job ends",
    )
    webhook_secret: SecretStr = Field(
        default=SecretStr(""), description="what signs webhooks: whsec_ and at least 24 bytes in base64"
    )

    # Proxies and browsers.
    host_names: str = Field(
        default="",
        pattern=r"^(|\*|[A-Za-z0-9.-]+(,\s*[A-Za-z0-9.-]+)*)$",
        description="without API keys: names, separated by commas, that the service answers to beside localhost and "
        "addresses, and without which it listens on this machine only; `*` for all",
    )
    root_path: str = Field(
        default="",
        pattern=r"^(|(/[A-Za-z0-9._~-]+)+)$",
        description="path under which a proxy serves this, and which it strips, such as /sg",
    )
    cors_origins: str = Field(
        default="",
        pattern=r"^(|\*|https?://[^/,\s*]+(,\s*https?://[^/,\s*]+)*)$",
        description="origins, separated by commas, whose pages may call the API from a browser; `*` for all",
    )

    # Requests.
    max_upload_bytes: int = Field(
        default=64 * 2**20,
        ge=1,
        description="maximum bytes of a request's body: an image, a form with one, or a bitstream; with less free disk "
        "than four of them, new jobs get 503 and /readyz fails",
    )
    max_pixels: int = Field(
        default=50_000_000,
        ge=1,
        description="maximum pixels (width x height) of an image, and of a decoded picture or view",
    )

    max_decodes: int = Field(default=3, ge=1, description="concurrent decodes; one client may use all but one")
    decode_time_s: float = Field(default=10.0, gt=0, le=LONGEST_S, description="maximum CPU seconds per decode")

    @field_validator("*", mode="before")
    @classmethod
    def _without_line_end(cls, value: object) -> object:
        """Strip white space: a secret read from a file often ends in a line end."""
        if not isinstance(value, str):
            return value
        value.encode()  # raises ValueError for what is not UTF-8
        return value.strip()

    @model_validator(mode="after")
    def _secrets_are_good(self) -> Settings:
        _ = self.key_names
        if 0 < len(self.link_secret.get_secret_value()) < MIN_SECRET_LENGTH:
            raise ValueError(f"SG_LINK_SECRET must have at least {MIN_SECRET_LENGTH} characters")
        if self.webhook_urls and len(self.webhook_key) < MIN_WEBHOOK_KEY_BYTES:
            raise ValueError("SG_WEBHOOK_URLS needs SG_WEBHOOK_SECRET: whsec_ and at least 24 bytes in base64")
        return self

    @field_validator("max_pixels")
    @classmethod
    def _images_can_be_read(cls, pixels: int) -> int:
        most = ImageLimits().max_pixels  # here, since it needs the kernels, which may be missing at import
        if pixels > most:
            raise ValueError(f"SG_MAX_PIXELS must be at most {most}: no larger image is read")
        return pixels

    @field_validator("trusted_proxies")
    @classmethod
    def _proxies_are_addresses(cls, text: str) -> str:
        for word in listed(text):
            ip_network(word)
        return text

    @field_validator("webhook_urls")
    @classmethod
    def _webhooks_can_be_sent(cls, text: str) -> str:
        try:
            for parts in map(urlsplit, listed(text)):
                _ = parts.port
                if parts.username is not None:
                    raise ValueError
                (parts.hostname or "").encode("idna")
        except ValueError:  # its message may hold a password
            raise ValueError("an address has a user, or a host or a port that cannot be one") from None
        return text

    @cached_property
    def key_names(self) -> dict[str, str]:
        """Names of API keys by their SHA-256, as read at the start; empty if there are none. Raises ValueError."""
        return self.read_keys()

    def read_keys(self) -> dict[str, str]:
        """Read the file of keys. Raises ValueError."""
        if self.api_keys_file is None:
            return {}
        try:
            keys = parse_keys(self.api_keys_file.read_text())
        except OSError as error:
            raise ValueError(f"SG_API_KEYS_FILE cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ValueError("SG_API_KEYS_FILE is not a text file") from error
        except ValueError as error:
            raise ValueError(f"SG_API_KEYS_FILE: {error}") from error
        if not keys:
            raise ValueError("SG_API_KEYS_FILE contains no key, which would leave the service open")
        return keys

    @property
    def max_queued_per_key(self) -> int:
        """Maximum number of queued jobs of one API key."""
        return -(-self.queue_length // 2)

    @property
    def min_free_bytes(self) -> int:
        """Free disk space in bytes below which new jobs are refused."""
        return MIN_FREE_UPLOADS * self.max_upload_bytes

    @property
    def job_timeout_s(self) -> float:
        """Seconds until a running encode is killed. Starting and finishing it takes time, too, on a busy machine."""
        return 2 * self.max_time_limit_s

    @property
    def webhook_addresses(self) -> tuple[str, ...]:
        """Addresses that receive a webhook when a job ends."""
        return tuple(listed(self.webhook_urls))

    @property
    def webhook_key(self) -> bytes:
        """The key that signs webhooks; empty unless the secret is well formed."""
        kind, _, encoded = self.webhook_secret.get_secret_value().rpartition("_")
        try:
            return base64.b64decode(encoded, validate=True) if kind == "whsec" else b""
        except ValueError:
            return b""

    @property
    def encode_threads(self) -> int:
        """Threads of one encode, so that all workers together do not exceed the cores."""
        return min(max(1, native.available_cores() // self.workers), MAX_THREADS)

    @property
    def uses_postgres(self) -> bool:
        """Whether the job table is in PostgreSQL."""
        return self.database_url.startswith("postgres")

    @property
    def database_path(self) -> Path:
        """The file of the job table."""
        return self.data_dir / "jobs.sqlite3"
