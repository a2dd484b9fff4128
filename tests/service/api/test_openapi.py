"""The OpenAPI document, and whether the service keeps to it whatever is sent."""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

import pytest
from PIL import Image

import sgmethod
from service.api.jobs import EXAMPLE_ID
from service.api.routes import HOST
from tests.support.data import PICTURE
from tests.support.pictures import SMALL
from tests.support.processes import run
from tests.support.service import FAKE_CODEC, StartService, keys_of

pytestmark = pytest.mark.thorough

# Valid against the document and refused all the same: a region beyond the picture, a form with two budgets.
NOT_CHECKED = "positive_data_acceptance"

OPEN = {"link_secret": "x" * 32}
GUARDED = {**OPEN, "api_keys": keys_of("ann")}


@pytest.mark.parametrize("settings", [OPEN, GUARDED], ids=["open", "guarded"])
def test_no_answer_is_beyond_the_document(
    start_service: StartService, tmp_path: Path, settings: dict[str, object]
) -> None:
    web = start_service("web", queue_length=10_000, **settings)
    owner, header = ("ann", ["--header=Authorization: Bearer ann"]) if settings is GUARDED else (None, [])
    config = tmp_path / "schemathesis.toml"
    # Nothing ends a job here, so no request waits for one.
    config.write_text(f'[parameters]\njob_id = "{web.published(PICTURE, owner)}"\nwait = 0\n')
    program = [str(Path(sys.executable).with_name("schemathesis")), "--config-file", str(config)]
    # What a key changes needs no second look at each field.
    phases = "examples,fuzzing" if settings is GUARDED else "examples,coverage,fuzzing"
    options = ["--max-examples=8", "--seed=1", f"--phases={phases}", "--suppress-health-check=all"]
    checks = ["--checks=all", f"--exclude-checks={NOT_CHECKED}", "--continue-on-failure", "--no-color"]
    command = [*program, "run", f"{web.url}/openapi.json", *header, *options, *checks]
    done = run(*command, folder=tmp_path)
    assert done.status == 0, done.stdout
    assert web.stop() == 0
    assert "Traceback" not in web.log.read_text()


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_every_operation_has_a_summary_and_a_command_that_works(start_service: StartService, tmp_path: Path) -> None:
    """As they stand at /docs to be copied, but for the address and the job's id."""
    settings = {"link_secret": "x" * 32, "source_retention_s": 1000, "max_time_limit_s": 2.0}
    service = start_service(extra=FAKE_CODEC, **settings)
    (tmp_path / "photo.jpg").write_bytes(SMALL)
    (tmp_path / "photo.sg").write_bytes(PICTURE)
    document = service.client.get("/openapi.json").json()
    done = service.wait(service.accepted())["id"]
    operations = [(method, path, what) for path, all_ in document["paths"].items() for method, what in all_.items()]
    for method, path, operation in sorted(operations):  # which comes to remove a job first
        assert operation["description"], (method, path)
        assert operation["summary"].lower() != operation["operationId"].partition("_")[0], "it has no summary"
        (sample,) = operation["x-codeSamples"]
        command = sample["source"].replace(HOST, service.url).replace(EXAMPLE_ID, done)
        asks = command.replace("curl", "curl -sS --fail -w '%{stderr}%{method} %{url_effective}'", 1)
        answer = run("sh", "-c", asks, folder=tmp_path)
        known = path.replace("{job_id}", done).replace("{kind}", command.partition("?")[0].rpartition(".")[2])
        address, _, _ = answer.stderr.partition("?")
        assert (answer.status, address) == (0, f"{method.upper()} {service.url}{known}"), (command, answer)
        if method == "delete":
            done = service.wait(service.accepted())["id"]
    assert sgmethod.info((tmp_path / "photo.sg").read_bytes()).width > 0
    pictures = ((tmp_path / name).read_bytes() for name in ("photo.png", "photo.avif", "photo.webp", "small.jpg"))
    assert [Image.open(io.BytesIO(picture)).format for picture in pictures] == ["PNG", "AVIF", "WEBP", "JPEG"]
