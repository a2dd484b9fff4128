"""What the page says of a file and how it shows it beside others: nothing that flatters, or frightens."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.service.page.steps import COFFEE, PHOTOGRAPH
from tests.support.browser import Chromium, bytes_of
from tests.support.pictures import SLOW, SMALL
from tests.support.processes import wait_until
from tests.support.service import Service

pytestmark = pytest.mark.thorough

POINT = {"seconds": 2, "psnr": 31.4, "bytes": 900, "gaussians": 250}
JOB = {"state": "running", "progress": 0.2, "trace": [POINT]}


@pytest.mark.parametrize(("codec", "nearest"), [("image/webp", 1.03), ("image/jpeg", 1.2)])
def test_another_codec_has_the_bytes_or_the_next_larger_size(
    page: Chromium, web: Service, codec: str, nearest: float
) -> None:
    """The steps of JPEG's quality are large in small files, those of WebP from 0 to 1 even more."""
    page.open_blank(web)
    wanted = list(range(4800, 14000, 700))
    sizes = page.run(f"""
        return (async () => {{
            const {{ Remote }} = await import("/static/parts.js");
            const worker = new Remote("/static/viewer/comparisons_worker.js");
            await worker.ask("original", {{ image: await createImageBitmap(new Blob([{bytes_of(PHOTOGRAPH)}])) }});
            const sizes = [];
            for (const bytes of {wanted}) {{
                sizes.push((await worker.ask("encode", {{ type: "{codec}", bytes, least: 0.97 * bytes }})).bytes);
            }}
            return sizes;
        }})();
    """)
    for size, want in zip(sizes, wanted, strict=True):
        assert size >= 0.97 * want
        assert size < nearest * want or size == min(sizes)  # no file is smaller
    assert sizes[-1] > 12_000


def test_a_verdict_says_the_bytes_where_they_differ(page: Chromium, web: Service) -> None:
    page.open_blank(web)
    verdicts = {
        (1020, 28.0, 0.8): "A is 2.0 dB further from the original.",
        (980, 31.5, 0.8): "A is 1.5 dB closer to the original.",
        (1000, 30.05, 0.95): "A is as close to the original.",
        (1000, 29.0, 0.95): "A is 1.0 dB further from the original, but closer by SSIM.",
        (1090, 31.0, 0.8): "A, with 9 % more bytes (1.1 kB), is 1.0 dB closer to the original.",
        (670, 26.8, 0.8): "A, with 33 % fewer bytes (670 B), is 3.2 dB further from the original.",
        (5200, 30.0, 0.9): "A, with 5.2 times the bytes (5.2 kB), is as close to the original.",
    }
    for (size, psnr, ssim), sentence in verdicts.items():
        comparisons = json.dumps({"A": {"bytes": size, "psnr": psnr, "ssim": ssim}})
        text = page.imported("viewer/comparisons.js", f"it.verdict(1000, {{ psnr: 30, ssim: 0.9 }}, {comparisons})")
        assert text == sentence
    exact = "it.verdict(1000, { psnr: 30, ssim: 0.9 }, { A: { bytes: 1000, psnr: Infinity, ssim: 1 } })"
    assert page.imported("viewer/comparisons.js", exact) == "A matches the original exactly."


def test_one_switch_shows_the_pixels_of_both_sides(page: Chromium, web: Service) -> None:
    """Of a part of the file as well."""

    def steps() -> int:
        return int((np.abs(np.diff(page.settled(), axis=0)).sum(1) > 0).sum())

    page.open(f"{web.url}/#astronaut")  # in which there is something everywhere
    page.says("Original", "#left-label")
    page.zoom_in()
    width = len(page.settled())
    most = width // 64 + 2  # whole pixels of 64 each
    page.click("#pixels")
    for side in ("Home", "End"):
        page.press("divider", side)
        wait_until(lambda: steps() <= most)
    page.press("divider", "Home")
    page.choose("prefix", 50)
    wait_until(lambda: steps() <= most)
    page.click("#pixels")
    for side in ("Home", "End"):
        page.press("divider", side)
        wait_until(lambda: steps() > 2 * most)
    assert page.complaints() == []


def test_no_quality_is_promised_before_it_is_measured(page: Chromium, web: Service) -> None:
    """How good a quarter bit per pixel is depends on the picture: some 30 Gaussians draw none."""
    page.open_page(web)
    page.choose("aim", "size")
    page.queued(SMALL, "small.png")
    assert "too few for more than a rough idea" in page.text("#rate-words")
    assert page.text("#outcome") == ""
    job_id = page.queued(PHOTOGRAPH, "coffee.webp")
    page.says("about 2,300 Gaussians.", "#rate-words")
    web.publish(job_id, COFFEE)
    page.says("9.0 kB, 0.30 bits per pixel, SSIMULACRA 2 60 (medium), 1 s; ", "#outcome")
    page.says("times smaller than the original.", "#outcome")
    page.click("#sample-cat")  # of which there is no job
    page.says("times smaller than the original; ", "#outcome")
    for ssim, words in ((0.67, "rough"), (0.8, "detail is lost"), (0.99, "hardly different")):
        assert words in page.imported("words.js", f"it.closeness({ssim})")
    page.run("localStorage.clear()")
    web.clear()


def test_an_encode_for_the_eye_shows_no_psnr(page: Chromium, service: Service) -> None:
    """It falls while the picture gets better."""
    page.open_page(service)
    page.give("drop", SLOW, "slow.png")
    page.says("Fitting")
    assert "dB" not in page.text("#status")
    assert not page.is_seen("#chart-card")
    page.cancel()
    for left, words in ((8.2, ", about 8 s left"), (0.2, ""), (None, "")):
        text = page.imported("progress.js", f"it.stateOf({json.dumps({**JOB, 'seconds_left': left})}).words")
        assert text == f"Fitting 250 Gaussians{words}"
    fitted = {**JOB, "progress": 1, "trace": [{**POINT, "step": 100, "steps": 100}]}
    last = page.imported("progress.js", f"it.stateOf({json.dumps(fitted)})")
    assert last == {"words": "Writing and measuring the file", "done": None}  # seconds, for a large picture


def test_the_curve_stays_within_its_axes(page: Chromium, web: Service) -> None:
    page.open_page(web)
    for psnrs in ([15.9, 30.4, 26.0], [26.02, 26.05, 26.04], [7, 12, 44.9], [30, 30, 30]):
        trace = [{"seconds": at, "psnr": psnr, "bytes": 900, "phase": "joint"} for at, psnr in enumerate(psnrs)]
        page.imported("progress.js", f"it.drawTrace({json.dumps(trace)}, {psnrs[-1]})")
        lines, points, labels = page.run("""
            const all = (kind) => [...document.querySelectorAll(`#chart ${kind}`)];
            return [
                all("line").map((line) => Number(line.getAttribute("y1"))),
                all("polyline")[0].getAttribute("points").split(" ").map((point) => Number(point.split(",")[1])),
                all("text").map((text) => [Number(text.getAttribute("x")), Number(text.getAttribute("y"))]),
            ];
        """)
        assert min(lines) <= min(points)
        assert max(points) <= max(lines)
        assert not any(62 < x < 546 and min(lines) < y < max(lines) for x, y in labels)  # no words in the curve's way
        assert f"The dot is the file: {psnrs[-1]:.1f} dB" in page.run(
            "return document.getElementById('chart-words').textContent"
        )
