"""Settings and command line."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import certifi
import pytest

from service import processes
from service.settings import Settings, add_secrets
from sgmethod import machine
from sgmethod.io.image import ImageLimits
from tests.support.data import ROOT
from tests.support.processes import TIMEOUT_S, Outcome, failing, run, wait_until
from tests.support.service import RunCommand, environment_of

COMPUTED = {
    "workers": "cores / 4, at least 1",
    "job_memory_bytes": "8 GiB, or less: what the machine or container has beyond 190 MB",
    **dict.fromkeys(("api_keys_file", "link_secret"), ""),
}


@pytest.fixture(autouse=True)
def no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in os.environ:
        if name.startswith("SG_"):
            monkeypatch.delenv(name)


def run_alone(command: str, **environment: object) -> Outcome:
    """In a process of its own."""
    return run(sys.executable, "-m", "service", command, **environment)


def test_the_operators_page_has_every_setting_with_its_default_and_meaning() -> None:
    text = (ROOT / "docs" / "deploy.md").read_text()
    rows = re.findall(r"^\| `SG_(\w+)` \| (.*?) \| (.+) \|$", text, re.MULTILINE)
    assert rows == [
        (name.upper(), COMPUTED.get(name, str(field.default)) or "none", field.description)
        for name, field in Settings.model_fields.items()
    ]


def test_secrets_may_be_files(tmp_path: Path) -> None:
    """As Compose and systemd hand them over."""
    for name in ("SG_LINK_SECRET", "AWS_SECRET_ACCESS_KEY", "PGPASSWORD", "other"):
        (tmp_path / name).write_text(f"{name} of a file\n")
    (tmp_path / "SG_FOLDER").mkdir()
    given = {"CREDENTIALS_DIRECTORY": str(tmp_path), "SG_LINK_SECRET": "", "PGPASSWORD": "given"}
    add_secrets(variables := dict(given))
    of_files = {name: f"{name} of a file" for name in ("SG_LINK_SECRET", "AWS_SECRET_ACCESS_KEY")}
    assert variables == {**given, **of_files}
    add_secrets(none := {"CREDENTIALS_DIRECTORY": str(tmp_path / "nowhere")})
    assert len(none) == 1

    (tmp_path / "SG_QUEUE_LENGTH").write_text("none\n")
    refused = run_alone("check", CREDENTIALS_DIRECTORY=tmp_path)
    assert refused.status == 2
    assert refused.stderr.startswith("SG_QUEUE_LENGTH: ")
    (tmp_path / "SG_QUEUE_LENGTH").write_bytes(b"\xff")
    refused = run_alone("check", CREDENTIALS_DIRECTORY=tmp_path)
    assert (refused.status, refused.stderr) == (1, f"cannot start: {tmp_path}/SG_QUEUE_LENGTH is not a text file\n")


def test_limits_never_exceed_what_the_encoder_reads() -> None:
    bound = ImageLimits().max_pixels
    assert Settings(max_pixels=bound).max_pixels == bound
    with pytest.raises(ValueError, match="max_pixels"):
        Settings(max_pixels=bound + 1)


@pytest.mark.parametrize("workers", [1, 2, 3, 64])
def test_threads_of_all_workers_stay_within_the_cores(workers: int) -> None:
    threads = Settings(workers=workers).encode_threads
    assert threads >= 1
    assert threads * workers <= max(machine.cores(), workers)


@pytest.mark.parametrize("cores", [1, 2, 8, 1000])
def test_workers_follow_the_cores(monkeypatch: pytest.MonkeyPatch, cores: int) -> None:
    monkeypatch.setattr(machine, "cores", lambda: cores)
    assert Settings().workers == min(max(1, cores // 4), 64)


@pytest.mark.parametrize("command", ["serve", "web", "worker", "check"])
def test_missing_kernels_are_one_clear_line(command: str) -> None:
    missing = "import sys; sys.modules['sgmethod.native._native'] = None"
    script = f"{missing}; from service.__main__ import main; sys.exit(main())"
    ran = run(sys.executable, "-c", script, command)
    assert (ran.status, ran.stdout) == (1, "")
    assert re.fullmatch(r"cannot start: the compiled part .* install --editable \.; elsewhere, .*\n", ran.stderr)


BAD = {
    "SG_PORT": ("x", "70000"),
    **{"SG_WORKERS": ("0", "65"), "SG_MAX_TIME_LIMIT_S": ("nan", "inf", "0")},
    **{"SG_JOB_MEMORY_BYTES": ("9" * 30,), "SG_MAX_PIXELS": ("9" * 30,), "SG_RETENTION_S": ("1e300",)},
    **{"SG_API_KEYS_FILE": ("/dev/null/keys",), "SG_DATA_DIR": ("\udcff",), "SG_STORAGE_URL": ("s3://b u", "ftp://x")},
    **{"SG_DATABASE_URL": ("mysql://x",), "SG_LOG_FORMAT": ("xml",), "SG_LOG_LEVEL": ("loud",)},
    "SG_TRUSTED_PROXIES": ("proxy.example", "10.0.0.1/8"),
    "SG_CORS_ORIGINS": ("a.example", "*,https://a.example"),
    **{"SG_HOST_NAMES": ("https://a.example",), "SG_ROOT_PATH": ("sg/",)},
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in BAD.items() for value in values])
def test_a_bad_setting_is_named_in_one_line(run_command: RunCommand, name: str, value: str) -> None:
    result = run_command("serve", **{name: value})
    assert result.status == 2
    assert re.fullmatch(rf"{name}[: ].+\n", result.stderr)
    assert "pattern" not in result.stderr  # which is a regular expression


def test_a_line_end_is_no_part_of_a_setting_and_an_empty_one_means_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("SG_LINK_SECRET", 32 * "x" + "\n"), ("SG_DATA_DIR", "x\n"), ("SG_PORT", "")):
        monkeypatch.setenv(name, value)
    settings = Settings()
    assert (settings.link_secret.get_secret_value(), settings.data_dir) == (32 * "x", Path("x"))
    assert settings.port == 8000


def test_keys_that_are_none_do_not_leave_all_open(run_command: RunCommand, tmp_path: Path) -> None:
    (tmp_path / "keys").write_text(",")
    result = run_command("serve", SG_API_KEYS_FILE=tmp_path / "keys")
    assert (result.status, result.stderr.count("\n")) == (2, 1)
    assert "leave the service open" in result.stderr


def test_a_misspelt_setting_is_named(tmp_path: Path) -> None:
    settings = {"SG_WORKER": "3", "SG_API_KEY": "the-clients", "SG_HOST": "no.such.host.invalid"}
    result = run_alone("serve", SG_DATA_DIR=tmp_path, **settings)
    assert result.status == 1
    misspelt, trouble = result.stderr.splitlines()
    assert misspelt.startswith("SG_WORKER is not a setting")
    assert trouble.startswith("cannot start: SG_HOST and SG_PORT, no.such.host.invalid:")


def test_a_taken_port_is_one_clear_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        result = run_alone("serve", SG_PORT=taken.getsockname()[1], SG_DATA_DIR=tmp_path / "data")
    assert result.status == 1
    assert re.fullmatch(r"cannot start: .*[Aa]ddress already in use.*\n", result.stderr)


@pytest.mark.thorough
@pytest.mark.parametrize("command", ["serve", "web", "worker"])
@pytest.mark.parametrize("file", ["data", "data/jobs.sqlite3", "data/sources"])
def test_a_data_folder_that_cannot_be_is_one_clear_line(
    run_command: RunCommand, tmp_path: Path, file: str, command: str
) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("this is neither a folder nor a database" * 100)
    start = run_alone if command == "web" else run_command  # which leaves its socket to the end of the process
    result = start(command, SG_PORT=0, SG_DATA_DIR=tmp_path / "data")
    assert result.status == 1
    (line,) = [line for line in result.stderr.splitlines() if "INFO" not in line]
    assert re.fullmatch("cannot start: .+", line)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("AWS_ENDPOINT_URL", "store.example", "malformed AWS_ variable"),
        ("AWS_ENDPOINT_URL", "ftp://store.example", "GET ftp://store.example"),
        ("AWS_SESSION_TOKEN", "to\nken", "malformed AWS_ variable"),
        ("AWS_SECRET_ACCESS_KEY", "key\n", "AWS_SECRET_ACCESS_KEY begins or ends with a space or a line end"),
        ("SSL_CERT_FILE", "/nowhere", "no certificates"),
    ],
)
def test_an_object_store_that_cannot_be_asked_is_one_clear_line(
    run_command: RunCommand, tmp_path: Path, name: str, value: str, words: str
) -> None:
    """The library panicked, which is a traceback, or named no cause."""
    keys = {"AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b", "AWS_ENDPOINT_URL": "http://127.0.0.1:1"}
    certificates = {"SSL_CERT_DIR": "/nowhere", "SSL_CERT_FILE": certifi.where()}  # whatever this machine has
    settings = {"SG_STORAGE_URL": "s3://bucket", "SG_DATA_DIR": tmp_path, **keys, **certificates}
    result = run_command("serve", **{**settings, name: value})
    assert result.status == 1
    assert re.fullmatch(f"cannot start: .*{words}.*\n", result.stderr)


@pytest.mark.thorough
@pytest.mark.parametrize(("command", "first_words"), [("serve", "sgmethod"), ("web", "sgmethod"), ("worker", "ready")])
def test_stopped_while_starting(tmp_path: Path, command: str, first_words: str) -> None:
    """SIGTERM as soon as it prints something: exit status 0 all the same."""
    environment = environment_of(port=0, data_dir=tmp_path / "data", workers=1, stop_grace_s=TIMEOUT_S)
    words, pipes = [sys.executable, "-m", "service", command], {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(words, cwd=ROOT, env=environment, text=True, **pipes) as process:
        assert process.stdout is not None
        assert any(first_words in line for line in process.stdout)  # the first lines may be warnings
        process.terminate()
        rest = process.stdout.read()
    assert process.returncode == 0
    assert "Traceback" not in rest
    assert "is killed" not in rest


def test_web_process_and_worker_never_import_torch() -> None:
    modules = "sys, service.api.app, service.worker.loop, service.processes"
    assert run(sys.executable, "-c", f"import {modules}; sys.exit('torch' in sys.modules)").status == 0


@pytest.mark.thorough
def test_a_process_that_cannot_be_started_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when the system is out of memory or processes for a moment: the supervisor outlives it."""
    monkeypatch.setattr(processes, "FIRST_PAUSE_S", 0.0)
    process = processes.Supervised("worker 1", [sys.executable, "--version"], ())
    process.process.wait()
    errors = [OSError(11, "Resource temporarily unavailable")] * 3
    monkeypatch.setattr(subprocess, "Popen", failing(subprocess.Popen, *errors))
    first = process.process
    wait_until(lambda: process.keep_alive() or process.process is not first)
    process.process.wait()
