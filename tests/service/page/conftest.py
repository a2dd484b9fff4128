"""The browser of the tests of the page."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.harness.browser import Chromium


@pytest.fixture
def page(browser: Chromium) -> Iterator[Chromium]:
    """The browser, which has nothing to complain of yet, and is elsewhere afterwards, in a window of its usual size."""
    browser.complaints()
    yield browser
    browser.tell("Emulation.clearDeviceMetricsOverride")
    browser.open("about:blank")
