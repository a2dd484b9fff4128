"""python -m benchmarks.service.previews: previews in Chromium: decoding, and a page of forty.

Decodes texts of 200 bytes to 256 pixels, after a few and after many, and shows a page with forty <sg-img>. Times are
milliseconds of processor time of the main thread, so that other processes count little; long tasks are of wall time.
"""

from __future__ import annotations

import functools
import json
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from sgmethod.previews.preview import preview
from tests.harness.browser import Chromium, find_driver
from tests.harness.data import JAVASCRIPT, PHOTOGRAPHS

BYTES, ELEMENTS, ROUNDS = 200, 40, 50
DECODE = """
    return import("/preview.js").then(({{ decodePreview }}) => {{
        for (let i = 0; i < {rounds}; i++) for (const text of {texts}) decodePreview(text);
    }});
"""
PAGE = """
    document.body.innerHTML = Array.from({{ length: {elements} }}, (_, i) =>
        `<sg-img src="none" preview="${{{texts}[i % {kinds}]}}"></sg-img>`).join("");
    return new Promise((done) => {{
        const tasks = [];
        new PerformanceObserver((list) => tasks.push(...list.getEntries().map((one) => one.duration)))
            .observe({{ type: "longtask" }});
        const drawn = (one) => one.shadowRoot?.querySelector("canvas");
        import("/sg-img.js");
        const timer = setInterval(() => {{
            if (![...document.querySelectorAll("sg-img")].every(drawn)) return;
            clearInterval(timer);
            setTimeout(() => done(tasks), 200);
        }}, 20);
    }});
"""


class Files(SimpleHTTPRequestHandler):
    """Says nothing."""

    def log_message(self, *_: Any) -> None:
        """Nothing."""


def spent(browser: Chromium, script: str) -> tuple[float, Any]:
    """Milliseconds of processor time that the main thread needs for a script, and what the script returns."""

    def tasks() -> float:
        metrics = browser.tell("Performance.getMetrics")["metrics"]
        return 1000 * float(next(one["value"] for one in metrics if one["name"] == "TaskDuration"))

    before = tasks()
    found = browser.run(script)
    return tasks() - before, found


def main() -> None:
    """Print the figures as JSON."""
    driver = find_driver()
    assert driver, "needs chromium and chromedriver"
    texts = [preview(path, BYTES).text for path in sorted(Path(PHOTOGRAPHS).glob("*.png"))]
    said = json.dumps(texts)
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Files, directory=str(JAVASCRIPT)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = Chromium(driver)
    try:
        browser.open(f"http://127.0.0.1:{server.server_port}/")
        browser.tell("Performance.enable", timeDomain="threadTicks")
        page, tasks = spent(browser, PAGE.format(texts=said, elements=ELEMENTS, kinds=len(texts)))
        decode = [spent(browser, DECODE.format(texts=said, rounds=ROUNDS))[0] / ROUNDS / len(texts) for _ in range(8)]
    finally:
        browser.close()
        server.shutdown()
    print(json.dumps({"page_of_forty": page, "long_tasks": tasks, "first": decode[0], "decode": min(decode[1:])}))


if __name__ == "__main__":
    main()
