"""Every setting of the service with its default and range.

Settings come from environment variables named SG_ and the field's name in capitals. docs/deploy.md says what each
means, and a test compares names and defaults.
"""

from __future__ import annotations

from collections.abc import Iterable, MutableMapping
from functools import cached_property
from ipaddress import ip_network
from pathlib import Path
from typing import ClassVar

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.keys import parse_keys
from service.logs import LogFormat, LogLevel
from sgmethod import machine
from sgmethod.io.image import ImageLimits
from sgmethod.threads import MAX_THREADS

MIN_SECRET_LENGTH = 32
MAX_SECONDS = 86_400.0  # small enough for the system and both databases
MAX_RETENTION_S = 100 * 365 * 86_400.0  # so that the expiry is a valid date
MIN_DECODE_BYTES = 512 << 20
MAX_WORKERS = 64  # processes of one machine
IDLE_BYTES = 190_000_000  # memory of a web process, a worker and the sandbox without work: docs/deploy.md, Memory
MIN_FREE_UPLOADS = 4  # with less space than this many of the largest uploads, the disk counts as full
ORIGIN = r"https?://[^/,\s*]+"
OTHER_NAMES = frozenset({"SG_API_KEY", "SG_THREADS", "SG_ISA"})  # the client's, and the kernels'

SECRETS = ("SG_", "AWS_", "PG")  # names of the service's, the bucket's and the database's variables begin so


def default_workers() -> int:
    """Return one worker for every four cores: an encode gains little beyond four threads."""
    return min(max(1, machine.cores() // 4), MAX_WORKERS)


def default_job_memory_bytes() -> int:
    """Return 8 GiB, or what an idle service leaves of this machine or container if that is less.

    With all of it, the system would kill an encode before its limit refuses it.
    """
    return max(min(machine.memory() - IDLE_BYTES, 8 * 2**30), 2**28)


def listed(text: str) -> list[str]:
    """Split a setting at its commas."""
    return list(filter(None, map(str.strip, text.split(","))))


def add_secrets(variables: MutableMapping[str, str]) -> None:
    """Add variables from the files of Compose's secrets, or of systemd's credentials, named like the variables.

    A variable that has a value keeps it. Raises OSError.
    """
    folder = Path(variables.get("CREDENTIALS_DIRECTORY") or "/run/secrets")
    for path in folder.glob("*"):
        if path.name.startswith(SECRETS) and not variables.get(path.name) and path.is_file():
            try:
                variables[path.name] = path.read_text().strip()  # often with a line end
            except ValueError as error:
                raise OSError(f"{path} is not a text file") from error


def unknown_settings(names: Iterable[str]) -> list[str]:
    """Return the names that look like settings but are not, such as misspelt ones."""
    known = {f"SG_{field}".upper() for field in Settings.model_fields} | OTHER_NAMES
    return sorted(name for name in names if name.startswith("SG_") and name not in known)


class Settings(BaseSettings):
    """The operator's settings, checked once at the start."""

    # One value suits everybody.
    max_waits: ClassVar[int] = 200
    max_waiting_decodes: ClassVar[int] = 64
    lease_s: ClassVar[float] = 15.0  # after which a silent worker's job goes to another worker
    stop_grace_s: ClassVar[float] = 10.0  # until processes that do not stop are killed
    decode_time_s: ClassVar[float] = 10.0  # of a core

    model_config = SettingsConfigDict(env_prefix="SG_", env_ignore_empty=True, frozen=True, allow_inf_nan=False)

    # The ten that most services need.
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)  # 0 takes a free one
    data_dir: Path = Path("data")
    workers: int = Field(default_factory=default_workers, ge=1, le=MAX_WORKERS)
    api_keys_file: Path | None = None
    trusted_proxies: str = ""  # addresses and networks, separated by commas
    retention_s: float = Field(default=30 * 86_400, ge=0, le=MAX_RETENTION_S)  # of finished jobs; 0 for ever
    quota_bytes: int = Field(default=0, ge=0)  # of all images and bitstreams; 0 for no limit
    database_url: str = Field(default="", pattern=r"^(|sqlite|postgres(ql)?://.*)$", repr=False)  # may hold a password
    storage_url: str = Field(default="", pattern=r"^(|s3://[A-Za-z0-9._-]+(/[^?#\s]*)?)$")

    # Jobs and encodes.
    queue_length: int = Field(default=1000, ge=1)
    max_time_limit_s: float = Field(default=300.0, gt=0, le=MAX_SECONDS)
    job_memory_bytes: int = Field(default_factory=default_job_memory_bytes, ge=2**28, le=2**62)
    require_sandbox: bool = False

    # Retention and quotas.
    source_retention_s: float = Field(default=3600.0, ge=0, le=MAX_RETENTION_S)
    quota_bytes_per_key: int = Field(default=0, ge=0)  # 0 for no limit

    # Links.
    link_secret: SecretStr = SecretStr("")

    # Proxies and browsers.
    host_names: str = Field(default="", pattern=r"^(|\*|[A-Za-z0-9.-]+(,\s*[A-Za-z0-9.-]+)*)$")
    root_path: str = Field(default="", pattern=r"^(|(/[A-Za-z0-9._~-]+)+)$")
    cors_origins: str = Field(default="", pattern=rf"^(|\*|{ORIGIN}(,\s*{ORIGIN})*)$")

    # Requests.
    max_upload_bytes: int = Field(default=64 * 2**20, ge=1)
    max_pixels: int = Field(default=50_000_000, ge=1)  # of an image, and of a picture or view to draw
    max_decodes: int = Field(default=3, ge=1)

    # Logs.
    log_format: LogFormat = "text"
    log_level: LogLevel = "info"

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
        return self

    @field_validator("max_pixels")
    @classmethod
    def _images_can_be_read(cls, pixels: int) -> int:
        max_pixels = ImageLimits().max_pixels  # here, since it needs the kernels, which may be missing at import
        if pixels > max_pixels:
            raise ValueError(f"SG_MAX_PIXELS must be at most {max_pixels}: no larger image is read")
        return pixels

    @field_validator("trusted_proxies")
    @classmethod
    def _proxies_are_addresses(cls, text: str) -> str:
        for word in listed(text):
            ip_network(word)
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
    def min_free_bytes(self) -> int:
        """Free disk space in bytes below which new jobs are refused."""
        return MIN_FREE_UPLOADS * self.max_upload_bytes

    @property
    def decode_memory_bytes(self) -> int:
        """Memory of one decode: a quarter of an encode's, but enough for 50 megapixels if an encode has that."""
        return min(max(self.job_memory_bytes // 4, MIN_DECODE_BYTES), self.job_memory_bytes)

    @property
    def job_timeout_s(self) -> float:
        """Seconds until a running encode is killed. Starting and finishing it takes time, too, on a busy machine."""
        return 2 * self.max_time_limit_s

    @property
    def encode_threads(self) -> int:
        """Threads of one encode, so that all workers together do not exceed the cores."""
        return min(max(1, machine.cores() // self.workers), MAX_THREADS)

    @property
    def uses_postgres(self) -> bool:
        return self.database_url.startswith("postgres")

    @property
    def database_path(self) -> Path:
        return self.data_dir / "jobs.sqlite3"
