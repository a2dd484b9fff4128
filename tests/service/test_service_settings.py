"""Settings and command line."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from service_process import ROOT

from service import settings as settings_module
from service.settings import Settings, available_cores
from sgmethod.image import DEFAULT_LIMITS

COMPUTED = {"workers": "cores / 4, at least 1", "api_keys": "", "api_keys_file": "", "link_secret": ""}


@pytest.fixture(autouse=True)
def no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in os.environ:
        if name.startswith("SG_"):
            monkeypatch.delenv(name)


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "service", *arguments]
    everything = {**os.environ, **environment}
    return subprocess.run(command, cwd=ROOT, env=everything, capture_output=True, text=True, timeout=60, check=False)


def expected_row(name: str, field: Any) -> str:
    default = COMPUTED.get(name, str(field.default))
    return f"| `SG_{name.upper()}` | {default or 'none'} | {field.description} |"


def test_the_operators_page_has_every_setting_with_its_default() -> None:
    rows = re.findall(r"^\| `SG_.*$", (ROOT / "docs" / "deploy.md").read_text(), re.MULTILINE)
    assert rows == [expected_row(name, field) for name, field in Settings.model_fields.items()]


def test_every_setting_says_what_it_is() -> None:
    for name, field in Settings.model_fields.items():
        assert field.description, name
        unit = name.rpartition("_")[2]
        if unit in ("s", "bytes", "pixels"):
            assert {"s": "seconds"}.get(unit, unit) in field.description, name


def test_limits_never_exceed_what_the_encoder_reads() -> None:
    bounds = {"max_pixels": DEFAULT_LIMITS.max_pixels, "max_side": DEFAULT_LIMITS.max_side}
    for name, bound in bounds.items():
        with pytest.raises(ValueError, match=name):
            Settings.model_validate({name: bound + 1})
        assert getattr(Settings.model_validate({name: bound}), name) == bound


@pytest.mark.parametrize("workers", [1, 2, 3, 100])
def test_threads_of_all_workers_stay_within_the_cores(workers: int) -> None:
    threads = Settings(workers=workers).encode_threads
    assert threads >= 1
    assert threads * workers <= max(available_cores(), workers)


def test_threads_can_be_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SG_THREADS", "7")
    assert Settings().encode_threads == 7


@pytest.mark.parametrize(("text", "cores"), [("max 100000", 8), ("250000 100000", 2), ("50000 100000", 1), ("?", 8)])
def test_a_containers_processor_quota_counts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str, cores: int
) -> None:
    quota = tmp_path / "cpu.max"
    quota.write_text(text)
    monkeypatch.setattr(settings_module, "CGROUP_CPU_LIMIT", quota)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: set(range(8)))
    assert available_cores() == cores
    assert Settings().workers == max(1, cores // 4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("SG_PORT", "x"),
        ("SG_PORT", "70000"),
        ("SG_WORKERS", "0"),
        ("SG_LEASE_S", "nan"),
        ("SG_MAX_SIDE", "-1"),
    ],
)
def test_a_bad_setting_is_named_in_one_line(name: str, value: str) -> None:
    result = run("serve", **{name: value})
    assert result.returncode == 2
    assert re.fullmatch(rf"{name}: .+\n", result.stderr)


def test_an_empty_setting_means_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SG_PORT", "")
    assert Settings().port == 8000


def test_time_limit_and_timeout_must_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SG_JOB_TIMEOUT_S", "10")
    with pytest.raises(ValueError, match="max_time_limit_s"):
        Settings()


def test_a_taken_port_is_one_clear_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        result = run("serve", SG_PORT=str(taken.getsockname()[1]), SG_DATA_DIR=str(tmp_path / "data"))
    assert result.returncode == 1
    assert re.fullmatch(r"cannot start: .*[Aa]ddress already in use.*\n", result.stderr)


def test_a_data_folder_that_cannot_be_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = run("serve", SG_PORT="0", SG_DATA_DIR=str(tmp_path / "file" / "data"))
    assert result.returncode == 1
    assert re.fullmatch(r"cannot start: .+\n", result.stderr)


def test_web_process_and_worker_never_import_torch() -> None:
    script = "import sys, service.app, service.worker, service.supervisor; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, timeout=60, check=False).returncode == 0
