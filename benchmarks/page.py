"""How soon the page is there, and how quick it is: first paint, bytes, a decode in JavaScript, a frame of a zoom.

    python -m benchmarks.page [--files a.sg,b.sg] [--runs 5] [--out FILE]

A service is started on this machine, and Chromium with an empty cache opens its page, as it is and over a slow network
with a slow processor. Then each file is decoded there, and drawn by WebGL at four times its size, both in turns;
"frame" is what the page itself shows while the picture moves. Without a graphics processor WebGL is software too.
"""

from __future__ import annotations

import argparse
import base64
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.machine import Record
from service.web.app import STATIC
from tests.harness.browser import Chromium, find_driver
from tests.harness.data import ROOT
from tests.harness.processes import wait_until
from tests.harness.service import ServiceProcess

SIZE = (1280, 900)
SAMPLES = sorted((STATIC / "samples").glob("*.sg"))
# Bytes a second and milliseconds of a slow telephone network, and how many times slower the processor is.
CONDITIONS: dict[str, tuple[int, int, int]] = {
    "as it is": (-1, 0, 1),
    "1.6 Mbit/s, 150 ms, 4 times": (200_000, 150, 4),
}
PAINT = "return performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? 0"
BYTES = """
    const entries = ["navigation", "resource"].flatMap((kind) => performance.getEntriesByType(kind));
    const before = entries.filter(({ name }) => !name.includes("/samples/"));
    return [before, entries].map((some) => some.reduce((sum, { transferSize }) => sum + transferSize, 0));
"""
DECODE = """
    return (async () => {
        const { readFile } = await import("/static/decoder/file.js");
        const { draw } = await import("/static/decoder/drawing.js");
        const { openGpu } = await import("/static/viewer/gpu.js");
        const bytes = Uint8Array.from(atob("BYTES"), (letter) => letter.charCodeAt(0));
        const gpu = openGpu();
        const timed = (work) => {
            const began = performance.now();
            work();
            return performance.now() - began;
        };
        let file;
        const took = { read: [], draw: [], webgl: [] };
        for (let run = 0; run < RUNS; run++) {
            took.read.push(timed(() => (file = readFile(bytes))));
            took.draw.push(timed(() => draw(file)));
            took.webgl.push(timed(() => {
                gpu.draw(file, file.count, [0, 0], 4, 870, 560);
                gpu.gl.readPixels(0, 0, 1, 1, gpu.gl.RGBA, gpu.gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for it
            }));
        }
        return { size: [file.width, file.height], gaussians: file.count, ...took };
    })();
"""
MOVE = """
    return new Promise((done) => {
        const stage = document.getElementById("stage");
        const frame = (left) => {
            const wheel = { deltaY: left > 30 ? -40 : 40, clientX: 400, clientY: 400, cancelable: true };
            stage.dispatchEvent(new WheelEvent("wheel", wheel));
            if (left) requestAnimationFrame(() => frame(left - 1));
            else done(document.getElementById("frame").textContent);
        };
        frame(60);
    });
"""


def first_look(browser: Chromium, url: str, runs: int) -> list[dict[str, Any]]:
    """A row for each condition: milliseconds to the first paint, bytes without and with the samples."""
    rows = []
    browser.tell("Network.enable")
    browser.tell("Network.setCacheDisabled", cacheDisabled=True)
    for name, (rate, latency_ms, slower) in CONDITIONS.items():
        limits = {"offline": False, "latency": latency_ms, "downloadThroughput": rate, "uploadThroughput": rate}
        browser.tell("Network.emulateNetworkConditions", **limits)
        browser.tell("Emulation.setCPUThrottlingRate", rate=slower)
        paints = []
        for _ in range(runs):
            browser.open("about:blank")
            browser.open(url)
            paints.append(float(wait_until(lambda: browser.run(PAINT))))
            wait_until(lambda: browser.is_seen("#left-label"))
        before, whole = browser.run(BYTES)
        milliseconds = {"median_ms": round(statistics.median(paints)), "least_ms": round(min(paints))}
        rows.append({"what": "first paint", "condition": name, **milliseconds, "bytes": before, "with_sample": whole})
    browser.tell("Network.disable")
    browser.tell("Emulation.setCPUThrottlingRate", rate=1)
    return rows


def drawn(browser: Chromium, file: Path, runs: int) -> dict[str, Any]:
    """Milliseconds of reading and drawing a file, and of WebGL, medians after the first run, and the first."""
    text = base64.b64encode(file.read_bytes()).decode()
    found = browser.run(DECODE.replace("BYTES", text).replace("RUNS", str(runs + 1)))
    row = {"what": "decode", "file": file.name, "size": found["size"], "gaussians": found["gaussians"]}
    for name in ("read", "draw", "webgl"):
        first, *others = found[name]
        row |= {f"{name}_ms": round(statistics.median(others), 1), f"{name}_first_ms": round(first, 1)}
    return row


def main() -> None:
    """Measure, print and write the JSON."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--files", type=lambda text: [Path(name) for name in text.split(",")], default=SAMPLES)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "bench" / "page.json")
    given = parser.parse_args()
    driver = find_driver()
    if driver is None:
        raise SystemExit("Chromium and its driver are needed: sudo apt install chromium chromium-driver")
    with tempfile.TemporaryDirectory() as folder:
        service = ServiceProcess(Path(folder) / "data", "web")
        browser = Chromium(driver, SIZE)
        try:
            rows = first_look(browser, f"{service.url}/", given.runs)
            time.sleep(2)  # until the rivals are made
            rows += [drawn(browser, file, given.runs) for file in given.files]
            rows.append({"what": "frame", "said": browser.run(MOVE)})
        finally:
            browser.close()
            service.stop()
    record = Record(given.out, "benchmarks.page", {"runs": given.runs})
    record.rows = []  # nothing here is worth keeping of an earlier run
    for row in rows:
        record.add(row)


if __name__ == "__main__":
    main()
