"""The dashboard and the alerts of docs/monitoring."""

from __future__ import annotations

import re

import pytest

from tests.support.data import ROOT
from tests.support.service import Service

PARTS = {"histogram": ("_bucket", "_sum", "_count"), "summary": ("_sum", "_count")}


@pytest.mark.parametrize("file", ["dashboard.json", "alerts.yaml"])
def test_they_name_metrics_that_exist(web: Service, file: str) -> None:
    text = web.client.get("/metrics").text
    kinds = re.findall(r"^# TYPE (\w+) (\w+)$", text, re.MULTILINE)
    known = {name + part for name, kind in kinds for part in PARTS.get(kind, ("",))}
    named = set(re.findall(r"\bsgmethod_\w+", (ROOT / "docs" / "monitoring" / file).read_text()))
    assert len(named) > 4
    assert named <= known
