"""The OpenAPI document, and whether the service keeps to it whatever is sent."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from service.keys import digest
from service.web.routes import answers
from tests.harness.data import golden_path
from tests.harness.service import Service, StartService

PICTURE = golden_path("v3-color.sg").read_bytes()
# Valid against the document and refused all the same: a region beyond the picture, a form with two budgets.
NOT_CHECKED = "positive_data_acceptance"


KEY = "key-of-ann"
OPEN = {"link_secret": "x" * 32}
GUARDED = {**OPEN, "api_keys": f"ann:{digest(KEY)}", "key_request_rate": 100_000, "max_queued_per_key": 0}


@pytest.mark.parametrize("settings", [OPEN, GUARDED], ids=["open", "guarded"])
def test_no_answer_is_beyond_the_document(
    start_service: StartService, tmp_path: Path, settings: dict[str, object]
) -> None:
    web = start_service("web", queue_length=10_000, **settings)
    owner, header = ("ann", [f"--header=Authorization: Bearer {KEY}"]) if settings is GUARDED else (None, [])
    config = tmp_path / "schemathesis.toml"
    config.write_text(f'[parameters]\njob_id = "{web.published(PICTURE, owner)}"\n')
    program = [str(Path(sys.executable).with_name("schemathesis")), "--config-file", str(config)]
    options = ["--max-examples=8", "--seed=1", "--phases=examples,coverage,fuzzing", "--suppress-health-check=all"]
    checks = ["--checks=all", f"--exclude-checks={NOT_CHECKED}", "--continue-on-failure", "--no-color"]
    command = [*program, "run", f"{web.url}/openapi.json", *header, *options, *checks]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout
    assert web.stop() == 0
    assert "Traceback" not in web.log.read_text()


def test_examples_are_what_they_are_examples_of() -> None:
    for view in (answers.AcceptedView, answers.JobSummary, answers.TraceView, answers.JobView):
        (example,) = view.model_json_schema()["examples"]
        assert set(example) == set(view.model_fields)
        view.model_validate(example)


def test_the_document_has_examples(web: Service) -> None:
    document = web.client.get("/openapi.json").json()
    assert "examples" in document["components"]["schemas"]["JobView"]
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            assert operation["description"], (path, method)
