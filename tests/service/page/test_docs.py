"""The page of requests: what it begins with, and whether everybody can read it."""

from __future__ import annotations

import pytest

from tests.harness.browser import Chromium
from tests.harness.data import DATA
from tests.harness.processes import wait_until
from tests.harness.service import Service

pytestmark = pytest.mark.thorough

AXE = (DATA / "axe.min.js").read_text()


@pytest.fixture
def requests(page: Chromium, web: Service) -> Chromium:
    """The browser with the page, complete."""
    page.open(f"{web.url}/docs")
    wait_until(lambda: page.run("return document.querySelectorAll('#operations details').length"))
    return page


def test_nobody_is_left_out(requests: Chromium) -> None:
    """Links on a dark ground had too little contrast."""
    requests.run("for (const one of document.querySelectorAll('details')) one.open = true")
    requests.run(AXE)
    for scheme in ("light", "dark"):
        requests.prefer(scheme)
        passed, findings = requests.run("""
            return axe.run().then(({ passes, violations, incomplete }) => [passes.length, [...violations, ...incomplete]
                .map(({ id, nodes }) => [id, ...nodes.map(({ target }) => target.join(" "))])]);
        """)
        assert passed > 10
        assert findings == []


def test_it_begins_with_an_encode(requests: Chromium) -> None:
    assert requests.text("#operations summary").startswith("POST /encode ")
