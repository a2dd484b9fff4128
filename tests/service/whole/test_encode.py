"""The whole road with real encodes: photograph in, bitstream and picture out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sgmethod
from sgmethod.profiles import DEFAULT_PROFILE
from tests.support.pictures import SMALL, pixels_of
from tests.support.processes import wait_until
from tests.support.service import Service, assert_problem


@pytest.fixture(scope="module")
def done(service: Service) -> dict[str, Any]:
    answer = service.post(SMALL, bpp=2, time_limit_s=2)
    assert answer.status_code == 202
    accepted = answer.json()
    job_id = accepted["id"]
    assert answer.headers["location"] == accepted["status_url"] == f"/jobs/{job_id}"
    assert accepted["decode_url"] == f"/decode/{job_id}.png"
    assert accepted["bitstream_url"] == f"/bitstreams/{job_id}.sg"
    job = service.wait(job_id)
    assert job["state"] == "done", job
    return job


def test_a_finished_job_tells_its_figures_and_its_trace(done: dict[str, Any]) -> None:
    assert (done["progress"], done["attempt"], done["position"], done["error"]) == (1, 1, None, None)
    assert done["created_at"] <= done["started_at"] <= done["finished_at"]
    assert (done["budget"], done["time_limit_s"]) == ({"kind": "bpp", "value": 2, "max_bpp": None}, 2)
    assert done["image"] == {"format": "PNG", "width": 64, "height": 48, "bytes": len(SMALL)}
    result = done["result"]
    assert (result["width"], result["height"], result["profile"]) == (64, 48, DEFAULT_PROFILE)
    assert result["bpp"] <= 2
    assert result["gaussians"] > 0
    assert len(done["trace"]) > 1
    seconds = [point["seconds"] for point in done["trace"]]
    assert seconds == sorted(seconds)
    assert done["trace"][-1]["psnr"] == pytest.approx(result["psnr"], abs=0.5)


def test_picture_and_bitstream_agree(service: Service, done: dict[str, Any]) -> None:
    bitstream = service.client.get(done["bitstream_url"])
    assert bitstream.status_code == 200
    assert len(bitstream.content) == done["result"]["bytes"]
    picture = service.client.get(done["decode_url"])
    assert picture.headers["content-type"] == "image/png"
    pixels = pixels_of(picture.content)
    np.testing.assert_array_equal(pixels, sgmethod.decode(bitstream.content))
    error = np.mean((pixels - pixels_of(SMALL).astype(float)) ** 2)
    assert 10 * np.log10(255**2 / error) == pytest.approx(done["result"]["psnr"], abs=0.01)


def test_what_the_codec_refuses_fails_at_once(service: Service) -> None:
    """Such as an image with a good header, and pixels that are missing."""
    job = service.wait(service.accepted(SMALL[: len(SMALL) // 2], bpp=1))
    assert (job["state"], job["attempt"], job["result"]) == ("failed", 1, None)
    assert job["error"]["code"] == "refused"
    assert "truncated" in job["error"]["detail"]
    problem = assert_problem(service.client.get(job["decode_url"]), 409, job["error"]["detail"])
    assert problem["state"] == "failed"
    wait_until(lambda: not [name for name in service.files() if job["id"] in name])
