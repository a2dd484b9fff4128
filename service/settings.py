"""Every setting of the service with its default and range.

Settings come from environment variables named SG_ and the field's name in capitals. The tables of docs/deploy.md are
those of this module.
"""

from __future__ import annotations

from collections.abc import Iterable, MutableMapping
from functools import cached_property
from ipaddress import ip_network
from pathlib import Path
from typing import Any, ClassVar

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


def _setting(default: object, text: str, **limits: Any) -> Any:
    """Return a setting. default: a value, or a function that finds it; text: its meaning; limits: as of Field()."""
    if callable(default):
        return Field(default_factory=default, description=text, **limits)
    return Field(default, description=text, **limits)


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
    host: str = _setting("127.0.0.1", "address to listen on; `0.0.0.0` is every IPv4 address, `::` every address")
    port: int = _setting(8000, "TCP port; 0 takes a free one", ge=0, le=65535)
    data_dir: Path = _setting(Path("data"), "folder for the job table, sources and bitstreams")
    workers: int = _setting(
        default_workers,
        "number of concurrent encodes on this machine, which share its cores; at most 64. With one for each core, "
        "many small photographs take about three quarters of the time, each of them longer",
        ge=1,
        le=MAX_WORKERS,
    )
    api_keys_file: Path | None = _setting(
        None, "file of API keys, one name:SHA-256 per line; without keys the service is open to all"
    )
    trusted_proxies: str = _setting("", "addresses and networks, separated by commas, whose X-Forwarded-For is trusted")
    retention_s: float = _setting(
        30 * 86_400, "seconds until finished jobs are removed; 0 for never", ge=0, le=MAX_RETENTION_S
    )
    quota_bytes: int = _setting(0, "bytes of all images and bitstreams before new jobs get 429; 0 for no limit", ge=0)
    database_url: str = _setting(
        "",
        "job table: empty or `sqlite` for a file in the data folder, or postgresql://...",
        pattern=r"^(|sqlite|postgres(ql)?://.*)$",
        repr=False,
    )
    storage_url: str = _setting(
        "",
        "sources and bitstreams: empty for the data folder, or s3://bucket/prefix",
        pattern=r"^(|s3://[A-Za-z0-9._-]+(/[^?#\s]*)?)$",
    )

    # Jobs and encodes.
    queue_length: int = _setting(
        1000,
        "queued jobs before new ones get 429; one API key, or without keys one address, may have half of them",
        ge=1,
    )
    max_time_limit_s: float = _setting(
        300.0,
        "seconds, the longest and default time limit of an encode; one that takes twice as long is ended and retried",
        gt=0,
        le=MAX_SECONDS,
    )
    job_memory_bytes: int = _setting(
        default_job_memory_bytes,
        "maximum bytes of memory per encode, which is refused beyond it; a decode may use a quarter, and at least "
        "512 MiB",
        ge=2**28,
        le=2**62,
    )
    require_sandbox: bool = _setting(
        False, "refuse to start where the system cannot confine processes that read uploads"
    )

    # Retention and quotas.
    source_retention_s: float = _setting(
        3600.0,
        "seconds to keep the image of a finished job for comparisons; 0 to delete it at once",
        ge=0,
        le=MAX_RETENTION_S,
    )
    quota_bytes_per_key: int = _setting(
        0, "bytes of the images and bitstreams of one API key before its new jobs get 429; 0 for no limit", ge=0
    )

    # Links.
    link_secret: SecretStr = _setting(SecretStr(""), "at least 32 characters that sign links; empty disables links")

    # Proxies and browsers.
    host_names: str = _setting(
        "",
        "without API keys: host names, separated by commas, that the service answers to besides localhost and IP "
        "addresses, `*` for all; if empty, the service does not start on an address that other machines can reach",
        pattern=r"^(|\*|[A-Za-z0-9.-]+(,\s*[A-Za-z0-9.-]+)*)$",
    )
    root_path: str = _setting(
        "",
        "path under which a proxy serves the service, such as /sg; the proxy strips it",
        pattern=r"^(|(/[A-Za-z0-9._~-]+)+)$",
    )
    cors_origins: str = _setting(
        "",
        "origins, separated by commas, whose pages may call the API from a browser; `*` for all",
        pattern=rf"^(|\*|{ORIGIN}(,\s*{ORIGIN})*)$",
    )

    # Requests.
    max_upload_bytes: int = _setting(
        64 * 2**20,
        "maximum bytes of a request's body: an image, a form with an image, or a bitstream; if the disk of the data"
        " folder has no room for four of them, new jobs get 503 and /readyz fails",
        ge=1,
    )
    max_pixels: int = _setting(
        50_000_000, "maximum pixels (width x height) of an image, and of a decoded picture or view", ge=1
    )
    max_decodes: int = _setting(3, "concurrent decodes; one client may use all but one", ge=1)

    # Logs.
    log_format: LogFormat = _setting(
        "text",
        "`text`, or `json`: one object a line, of the start too, in which a request's id, method, path, status and "
        "others are members",
    )
    log_level: LogLevel = _setting("info", "the least that is logged: `debug`, `info`, `warning` or `error`")

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
        """Seconds until a running encode is ended. Starting and finishing it takes time, too, on a busy machine."""
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
