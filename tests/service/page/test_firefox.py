"""The main road in the other browser: a picture dropped, encoded, compared, zoomed; a file opened and decoded."""

from __future__ import annotations

import numpy as np
import pytest

import sgmethod
from tests.harness.browser import Firefox
from tests.harness.pictures import SMALL
from tests.harness.processes import wait_until
from tests.harness.service import Service
from tests.service.page.steps import COFFEE, COFFEE_SAYS, decoded, give, open_page, says, settled

pytestmark = pytest.mark.thorough


def test_the_main_road(firefox: Firefox, service: Service) -> None:
    open_page(firefox, service)
    says(firefox, "AVIF", "#verdict")
    give(firefox, "drop", SMALL, "disc.png")
    says(firefox, "disc.png is done", "#said")
    assert "Original" in firefox.text("#left-label")
    wait_until(lambda: "WebP" in firefox.text("#verdict"))
    both = settled(firefox)
    firefox.run("document.getElementById('divider').dispatchEvent(new KeyboardEvent('keydown', { key: 'Home' }))")
    wait_until(lambda: not np.array_equal(settled(firefox), both))
    firefox.click("#zoom-in")
    firefox.click("#zoom-in")
    assert firefox.text("#zoom").endswith("%")
    give(firefox, "drop", COFFEE, "coffee.sg")
    says(firefox, COFFEE_SAYS, "#figures")
    difference = np.abs(decoded(firefox, COFFEE)[..., :3].astype(int) - sgmethod.decode(COFFEE))
    assert difference.max() <= 1
    assert np.count_nonzero(difference) <= difference.size // 10_000
    firefox.click("#rows li:first-child .pick")
    says(firefox, "disc.png", "#rows")
    assert firefox.complaints() == []
