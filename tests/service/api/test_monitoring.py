"""The dashboard and the alerts of docs/monitoring, and the manifests of docs/kubernetes."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from service.api.problems import NAMED_REASONS, REASONS
from tests.conftest import missing
from tests.support.data import ROOT
from tests.support.processes import run
from tests.support.service import Service

PARTS = {"histogram": ("_bucket", "_sum", "_count"), "summary": ("_sum", "_count")}
MONITORING = ROOT / "docs" / "monitoring"
PROMTOOL = shutil.which("promtool")
REQUIRED = "SGMETHOD_TEST_PROMTOOL"  # set to "required", a missing promtool fails the test
HINT = "promtool is not installed, so no alert was tried: sudo apt install prometheus"

MINUTES = 120
# What a service in order says each minute, in the language of promtool.
UP = 'up{job="sgmethod"}'
STORAGE, LAYER = 'sgmethod_refusals_total{reason="storage"}', 'sgmethod_sandbox_layer_up{layer="seccomp"}'
TABLE_UP, FREE = "sgmethod_job_table_up", "sgmethod_free_bytes"
QUEUE, SILENT = "sgmethod_oldest_job_waits_seconds", "sgmethod_workers_silent_seconds"
FINISHED, FAILED, RETRIED, PUT_OFF = (
    f"sgmethod_jobs_{name}_total" for name in ("finished", "failed", "retried", "put_off")
)
IN_ORDER = {
    **{UP: "1x120", TABLE_UP: "1x120", LAYER: "1x120", FREE: "5e9x120", STORAGE: "0x120"},
    **{QUEUE: "30x120", SILENT: "1x120"},
    **{FINISHED: "0+60x120", FAILED: "0+1x120", RETRIED: "0x120", PUT_OFF: "0x120"},  # a few are refused by the codec
}
# What is different when an alert fires; None: it is not there. A burst is seen from the first minute on.
TROUBLE: dict[str, list[dict[str, str | None]]] = {
    "SgmethodDown": [{UP: "0x120"}, {UP: "1x60 0x60"}, dict.fromkeys(IN_ORDER)],
    "SgmethodJobTableDown": [{TABLE_UP: "0x120"}],
    "SgmethodJobsStall": [{QUEUE: "100x120", SILENT: "60+60x120"}],
    "SgmethodQueueGrows": [{QUEUE: "0+60x120"}],
    "SgmethodJobsFail": [{FAILED: "0+10x120"}, {FAILED: "0x118 0 20", FINISHED: "0x120"}],
    "SgmethodEncodesCrash": [{RETRIED: "0x110 0+1x10"}],
    "SgmethodImagesMissing": [{PUT_OFF: "0x115 0+1x5"}],
    "SgmethodSandboxLayerMissing": [{LAYER: "0x120"}],
    "SgmethodDiskAlmostFull": [{FREE: "5e8x120"}],
    "SgmethodFaults": [{STORAGE: "0x118 0 20"}],
}


@pytest.mark.parametrize("file", ["dashboard.json", "alerts.yaml"])
def test_they_name_metrics_that_exist(web: Service, file: str) -> None:
    text = web.client.get("/metrics").text
    kinds = re.findall(r"^# TYPE (\w+) (\w+)$", text, re.MULTILINE)
    known = {name + part for name, kind in kinds for part in PARTS.get(kind, ("",))}
    named = set(re.findall(r"\bsgmethod_\w+", (MONITORING / file).read_text()))
    assert len(named) > 4
    assert named <= known


def test_counters_are_there_before_they_count(web: Service) -> None:
    """Prometheus' increase() does not see the value that a series begins with: a burst after a start went unnoticed."""
    names = web.figures()
    reasons = {*REASONS.values(), *NAMED_REASONS}
    assert {f'sgmethod_refusals_total{{reason="{reason}"}}' for reason in reasons} <= names.keys()


def _case(changes: dict[str, str | None], alerts: list[str]) -> dict[str, Any]:
    series = {name: values for name, values in {**IN_ORDER, **changes}.items() if values is not None}
    expected = [{"labels": f'{{alertname="{alert}"}}', "value": 1} for alert in alerts]
    firing = 'group by (alertname) (ALERTS{alertstate="firing"})'
    return {
        "interval": "1m",
        "input_series": [{"series": name, "values": values} for name, values in series.items()],
        "promql_expr_test": [{"expr": firing, "eval_time": f"{MINUTES}m", "exp_samples": expected}],
    }


def test_each_alert_fires_when_it_should_and_no_other(tmp_path: Path) -> None:
    if PROMTOOL is None:
        missing(REQUIRED, HINT)
    rules = MONITORING / "alerts.yaml"
    assert sorted(TROUBLE) == sorted(re.findall(r"alert: (\w+)", rules.read_text()))
    cases = [_case({}, []), *(_case(changes, [alert]) for alert, all_ in TROUBLE.items() for changes in all_)]
    file = tmp_path / "tests.yaml"
    file.write_text(json.dumps({"rule_files": [str(rules)], "evaluation_interval": "1m", "tests": cases}))
    checked, tested = run(PROMTOOL, "check", "rules", rules), run(PROMTOOL, "test", "rules", file)
    assert (checked.status, tested.status) == (0, 0), (checked, tested)


@pytest.mark.thorough
def test_manifests_are_valid() -> None:
    pytest.importorskip("kubernetes_validate", reason="pip install kubernetes-validate")
    program = Path(sys.executable).with_name("kubernetes-validate")
    done = run(program, "--strict", *sorted((ROOT / "docs" / "kubernetes").glob("*.yaml")))
    assert done.status == 0, done
    assert len(re.findall(" passed for resource ", done.stdout + done.stderr)) == 8
