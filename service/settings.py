"""Every setting of the service: its unit, its default, its range.

Settings come from environment variables named SG_ and the field's name in capitals. docs/deploy.md
holds the same table; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from ipaddress import ip_network
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.keys import parse_keys
from service.logs import LogFormat
from sgmethod.io.image import ImageLimits
from sgmethod.native import native

MIN_SECRET_LENGTH = 32
LONGEST_S = 86_400.0  # what the system and both databases can surely count
MOST = 10**9
OTHER_NAMES = frozenset({"SG_API_KEY"})  # the client's


def available_cores() -> int:
    """Cores this process may use: its affinity, cut by the processor quotas of its control groups."""
    return native.available_cores()


def default_workers() -> int:
    """One encoder for every four cores: an encode gains little beyond four threads."""
    return max(1, available_cores() // 4)


def unknown_settings(names: Iterable[str]) -> list[str]:
    """Those of the names that look like settings and are none, as misspelt ones do."""
    known = {f"SG_{field}".upper() for field in Settings.model_fields} | OTHER_NAMES
    return sorted(name for name in names if name.startswith("SG_") and name not in known)


def _named_keys(setting: str, text: str) -> dict[str, str]:
    try:
        return parse_keys(text)
    except ValueError as error:
        raise ValueError(f"{setting}: {error}") from error


class Settings(BaseSettings):
    """What the operator may set; every value is checked once, at start."""

    model_config = SettingsConfigDict(env_prefix="SG_", env_ignore_empty=True, frozen=True, allow_inf_nan=False)

    host: str = Field(default="127.0.0.1", description="address to listen on")
    port: int = Field(default=8000, ge=0, le=65535, description="TCP port; 0 takes a free one")
    data_dir: Path = Field(default=Path("data"), description="folder of the job table, sources and bitstreams")

    database_url: str = Field(
        default="",
        pattern=r"^(|sqlite|postgres(ql)?://.*)$",
        repr=False,  # it may hold a password
        description="job table: empty or `sqlite` for a file in the data folder, or postgresql://...",
    )
    storage_url: str = Field(
        default="",
        pattern=r"^(|s3://.+)$",
        description="sources and bitstreams: empty for the data folder, or s3://bucket/prefix",
    )
    retention_s: float = Field(
        default=30 * 86_400, ge=0, description="seconds after which finished jobs are removed; 0 for never"
    )
    source_retention_s: float = Field(
        default=3600.0,
        ge=0,
        description="seconds for which the image of a finished job is kept to be encoded again; 0 for not at all",
    )
    min_free_bytes: int = Field(
        default=2**28, ge=0, description="bytes free in the data folder, below which new jobs get 503 and /readyz fails"
    )
    quota_bytes: int = Field(default=0, ge=0, description="bytes of images and bitstreams in all; 0 for any number")
    quota_bytes_per_key: int = Field(default=0, ge=0, description="the same of one API key; 0 for any number")
    quota_full: Literal["refuse", "oldest"] = Field(
        default="refuse",
        description="beyond a quota: `refuse` new jobs with 429, or remove the `oldest` that are finished",
    )
    log_format: LogFormat = Field(default="text", description="lines of the logs: `text`, or `json` for machines")

    workers: int = Field(default_factory=default_workers, ge=1, description="encodes that run at once")
    threads: int = Field(default=0, ge=0, description="threads of one encode; 0 divides the cores among the workers")
    queue_length: int = Field(default=100, ge=1, description="jobs waiting before new ones get 429")

    api_keys: str = Field(
        default="", description="names and SHA-256 of API keys, as name:digest, apart by commas; none leaves all open"
    )
    api_keys_file: Path | None = Field(default=None, description="file of more such keys, one a line")
    key_request_rate: float = Field(
        default=50.0, gt=0, description="requests a second of one API key, twice as many at once, before 429"
    )
    max_queued_per_key: int = Field(
        default=50, ge=0, description="jobs of one API key waiting before new ones get 429; 0 for any number"
    )
    metrics_key: str = Field(
        default="", description="name of the API key that alone may read /metrics, which names all; empty for any key"
    )
    link_secret: SecretStr = Field(
        default=SecretStr(""), description="32 characters or more that sign links; without it there are none"
    )
    link_max_age_s: int = Field(default=7 * 86_400, ge=1, description="seconds, the longest life of a link")

    max_connections: int = Field(
        default=1000, ge=1, description="connections at once before the slowest is closed, or new ones get 503"
    )
    max_connections_per_address: int = Field(
        default=200, ge=1, description="connections at once of one address before its slowest is closed, or 429"
    )
    trusted_proxies: str = Field(
        default="",
        description="addresses and networks, apart by commas, whose X-Forwarded-For names the client; no limit on them",
    )
    path_prefix: str = Field(
        default="",
        pattern=r"^(|(/[A-Za-z0-9._~-]+)+)$",
        description="path under which a proxy shows the service, such as /sg, whether or not it cuts it off",
    )
    cors_origins: str = Field(
        default="",
        pattern=r"^(|\*|https?://[^/,\s*]+(,\s*https?://[^/,\s*]+)*)$",
        description="origins, apart by commas, whose pages may ask from a browser, or `*` for all",
    )
    max_header_bytes: int = Field(default=32_768, ge=1024, description="bytes of a request line with its headers")
    header_timeout_s: float = Field(
        default=10.0, gt=0, le=LONGEST_S, description="seconds for a request line with its headers"
    )
    send_timeout_s: float = Field(
        default=60.0,
        ge=1,
        le=LONGEST_S,
        description="seconds for which a client may leave 256 KiB of an answer untaken before it is cut off",
    )
    max_answer_bytes: int = Field(
        default=512 * 2**20,
        ge=1,
        description="bytes of answers that clients have yet to take before new pictures get 503; one client has half",
    )
    max_uploads: int = Field(
        default=100, ge=1, description="request bodies coming in at once before new ones get 503; one client has half"
    )
    max_event_streams: int = Field(
        default=100, ge=1, description="streams of events at once before new ones get 503; one client has half"
    )

    max_upload_bytes: int = Field(default=64 * 2**20, ge=1, description="bytes of one image file")
    max_pixels: int = Field(default=50_000_000, ge=1, description="pixels (width x height) of one image")
    max_side: int = Field(default=16_384, ge=1, description="pixels of an image's longer side")
    body_chunk_timeout_s: float = Field(default=5.0, gt=0, description="seconds without a byte of an upload before 408")
    body_timeout_s: float = Field(default=120.0, gt=0, description="seconds for a whole upload before 408")
    min_upload_rate: int = Field(
        default=2000, ge=1, description="bytes a second that an upload must bring on average before 408"
    )

    max_time_limit_s: float = Field(
        default=300.0,
        gt=0,
        description="seconds, the longest time limit of an encode, and the one it has unasked",
    )
    job_timeout_s: float = Field(default=600.0, gt=0, description="seconds after which a running encode is ended")
    job_memory_bytes: int = Field(default=8 * 2**30, ge=2**28, le=2**62, description="bytes of memory of one encode")
    lease_s: float = Field(
        default=15.0, ge=1, le=LONGEST_S, description="seconds after which a lost worker's job goes to another"
    )
    max_attempts: int = Field(default=4, ge=1, le=MOST, description="crashes after which a job has failed")
    max_running_per_key: int = Field(
        default=0, ge=0, le=MOST, description="jobs of one API key that run at once; 0 for any number"
    )

    max_decodes: int = Field(
        default=3, ge=1, description="pictures decoded at once; one client has all but one at most"
    )
    max_waiting_decodes: int = Field(default=64, ge=0, description="decodes waiting before new ones get 503")
    decode_time_s: float = Field(
        default=10.0, gt=0, le=LONGEST_S, description="seconds of one core that a decode may take"
    )
    decode_memory_bytes: int = Field(default=2 * 2**30, ge=2**26, le=2**62, description="bytes of memory of one decode")
    decode_cache_bytes: int = Field(default=64 * 2**20, ge=0, description="bytes of picture files kept in memory")
    max_decode_pixels: int = Field(default=50_000_000, ge=1, description="pixels of one decoded picture or view")
    max_decode_gaussians: int = Field(
        default=1_000_000, ge=1, description="Gaussians of a bitstream posted to be decoded"
    )
    max_bitstream_bytes: int = Field(default=16 * 2**20, ge=1, description="bytes of a bitstream posted to be decoded")
    stall_s: float = Field(
        default=60.0, gt=0, description="seconds that jobs wait without any worker's sign of life before /readyz fails"
    )
    stop_grace_s: float = Field(
        default=10.0, gt=0, le=LONGEST_S, description="seconds to stop in before processes are killed"
    )

    @model_validator(mode="after")
    def _keys_can_be_read(self) -> Settings:
        _ = self.key_names
        if 0 < len(self.link_secret.get_secret_value()) < MIN_SECRET_LENGTH:
            raise ValueError(f"SG_LINK_SECRET must have at least {MIN_SECRET_LENGTH} characters")
        return self

    @model_validator(mode="after")
    def _images_can_be_read(self) -> Settings:
        most = ImageLimits()
        for name in ("max_pixels", "max_side"):
            if getattr(self, name) > getattr(most, name):
                raise ValueError(f"SG_{name.upper()} must be at most {getattr(most, name)}: no larger image is read")
        return self

    @field_validator("trusted_proxies")
    @classmethod
    def _proxies_are_addresses(cls, text: str) -> str:
        for word in filter(None, map(str.strip, text.split(","))):
            ip_network(word)
        return text

    @model_validator(mode="after")
    def _limit_before_timeout(self) -> Settings:
        if self.max_time_limit_s >= self.job_timeout_s:
            raise ValueError("SG_MAX_TIME_LIMIT_S must be less than SG_JOB_TIMEOUT_S")
        return self

    @cached_property
    def key_names(self) -> dict[str, str]:
        """Names of API keys by their SHA-256, as they were at the start; empty if there are none. Raises ValueError."""
        return self.read_keys()

    def read_keys(self) -> dict[str, str]:
        """The same as they are now."""
        keys = _named_keys("SG_API_KEYS", self.api_keys)
        if self.api_keys_file is not None:
            try:
                text = self.api_keys_file.read_text()
            except OSError as error:
                raise ValueError(f"SG_API_KEYS_FILE cannot be read: {error.strerror}") from error
            except UnicodeDecodeError as error:
                raise ValueError("SG_API_KEYS_FILE is not a text file") from error
            keys |= _named_keys("SG_API_KEYS_FILE", text)
        if not keys and (self.api_keys or self.api_keys_file):
            raise ValueError("SG_API_KEYS and SG_API_KEYS_FILE contain no key, which would leave the service open")
        return keys

    @property
    def encode_threads(self) -> int:
        """Threads of one encode, such that all workers together stay within the cores."""
        return self.threads or max(1, available_cores() // self.workers)

    @property
    def uses_postgres(self) -> bool:
        """Whether the job table is in PostgreSQL."""
        return self.database_url.startswith("postgres")

    @property
    def database_path(self) -> Path:
        """The file of the job table."""
        return self.data_dir / "jobs.sqlite3"
