"""The browser of the tests of the page."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.harness.browser import Chromium


@pytest.fixture
def page(browser: Chromium) -> Iterator[Chromium]:
    """The browser, which has nothing to complain of yet, and is elsewhere afterwards."""
    browser.complaints()
    yield browser
    browser.open("about:blank")
