"""How much hypothesis tries: little in `make test`, much in `make thorough`; and fixtures that all tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest
from hypothesis import HealthCheck, settings
from PIL import Image

from sgmethod.native import native
from tests.support.data import golden_path
from tests.support.pictures import photo

if TYPE_CHECKING:
    from tests.support.browser import Chromium, Firefox, Page

# Torch's, when it is imported: most arrays here are so small that a second thread only costs time.
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile(
    "quick", max_examples=100, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
)
settings.register_profile("thorough", settings.get_profile("quick"), max_examples=4000)
settings.load_profile("quick")


@pytest.fixture
def set_threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of the kernels' threads, which afterwards is as it was."""
    before = native.thread_count()
    yield native.set_thread_count
    native.set_thread_count(before)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with photo.png, of 128 x 96 pixels, and picture.sg, of 48 x 40, which is the working directory."""
    monkeypatch.chdir(tmp_path)
    Image.fromarray(photo()).save("photo.png")
    (tmp_path / "picture.sg").write_bytes(golden_path("v2-color.sg").read_bytes())
    return tmp_path


def missing(required: str, hint: str) -> NoReturn:
    """Skip, or fail where the environment says that the program is required."""
    if os.environ.get(required) == "required":
        pytest.fail(hint)
    pytest.skip(hint)


@pytest.fixture(scope="session")
def browser() -> Iterator[Chromium]:
    """A browser for all tests that need one."""
    from tests.support import browser as drivers  # not above: .ci/versions installs no selenium

    if not (drivers.CHROMIUM and drivers.CHROMEDRIVER):
        missing(drivers.REQUIRED, drivers.HINT)
    browser = drivers.Chromium()
    yield browser
    browser.close()


@pytest.fixture(scope="session")
def firefox() -> Iterator[Firefox]:
    """The other browser."""
    from tests.support import browser as drivers

    if not drivers.FIREFOX:
        missing(drivers.REQUIRED, drivers.FIREFOX_HINT)
    browser = drivers.Firefox()
    yield browser
    browser.close()


@pytest.fixture
def page(browser: Chromium) -> Iterator[Chromium]:
    """The browser, which has nothing to complain of yet, and is elsewhere afterwards, in a window of its usual size."""
    browser.complaints()
    yield browser
    browser.tell("Emulation.clearDeviceMetricsOverride")
    browser.open("about:blank")


@pytest.fixture(params=["browser", pytest.param("firefox", marks=pytest.mark.thorough)])
def each_browser(request: pytest.FixtureRequest) -> Iterator[Page]:
    """The same for tests that run in both."""
    browser: Page = request.getfixturevalue(request.param)
    browser.complaints()
    yield browser
    browser.open("about:blank")
