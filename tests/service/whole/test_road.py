"""The whole road with real encodes: photograph in, bitstream and picture out."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.profiles import DEFAULT_PROFILE
from tests.harness.pictures import SMALL, png
from tests.harness.processes import wait_until
from tests.harness.service import Service, assert_problem


@pytest.fixture(scope="module")
def done(service: Service) -> dict[str, Any]:
    job = service.wait(service.accepted(SMALL, bpp=2, time_limit_s=2))
    assert job["state"] == "done", job
    return job


def test_answer_to_an_accepted_image(service: Service) -> None:
    answer = service.post(SMALL, gaussians=40, profile="baseline", time_limit_s=1)
    assert answer.status_code == 202
    accepted = answer.json()
    job_id = accepted["id"]
    assert answer.headers["location"] == accepted["status_url"] == f"/jobs/{job_id}"
    assert accepted["decode_url"] == f"/decode/{job_id}.png"
    assert accepted["bitstream_url"] == f"/bitstreams/{job_id}.sg"
    job = service.job(job_id)
    assert job["budget"] == {"kind": "gaussians", "value": 40}
    assert (job["profile"], job["time_limit_s"]) == ("baseline", 1)
    assert job["image"] == {"format": "PNG", "width": 64, "height": 48, "bytes": len(SMALL)}
    assert service.wait(job_id)["result"]["profile"] == "baseline"


def test_a_quality(service: Service) -> None:
    job = service.wait(service.accepted(SMALL, quality=40, time_limit_s=1))
    assert job["budget"] == {"kind": "quality", "value": 40}
    assert (job["state"], job["result"]["profile"]) == ("done", "rd")


def test_a_finished_job_tells_its_figures_and_its_trace(done: dict[str, Any]) -> None:
    assert (done["progress"], done["attempt"], done["position"], done["error"]) == (1, 1, None, None)
    assert done["created_at"] <= done["started_at"] <= done["finished_at"]
    result = done["result"]
    assert (result["width"], result["height"], result["profile"]) == (64, 48, DEFAULT_PROFILE)
    assert result["bpp"] <= 2
    assert result["gaussians"] > 0
    assert len(done["trace"]) > 1
    seconds = [point["seconds"] for point in done["trace"]]
    assert seconds == sorted(seconds)
    assert done["trace"][-1]["psnr"] == pytest.approx(result["psnr"], abs=0.5)


@pytest.mark.thorough
def test_an_encode_that_is_stopped(service: Service) -> None:
    """It keeps to its budget, and takes nothing like its 100 seconds."""
    job_id = service.accepted_slow()
    first, *_ = wait_until(lambda: service.job(job_id)["trace"])
    preview = wait_until(lambda: (answer := service.client.get(f"/jobs/{job_id}/preview.sg")).content and answer)
    assert preview
    assert sgmethod.decode(preview.content).shape == (768, 768, 3)
    answer = service.client.post(f"/jobs/{job_id}/stop")
    assert (answer.status_code, answer.headers["location"]) == (202, f"/jobs/{job_id}")
    job = service.wait(job_id)
    assert (job["state"], job["time_limit_s"]) == ("done", 100)
    assert 0 < job["result"]["bpp"] <= 1
    assert job["result"]["steps"] < first["steps"]
    assert service.client.post(f"/jobs/{job_id}/stop").status_code == 202  # nothing is left to do
    last = service.client.get(f"/jobs/{job_id}/preview.sg", headers={"If-None-Match": preview.headers["etag"]})
    assert last.content == service.client.get(f"/bitstreams/{job_id}.sg").content
    service.client.delete(f"/jobs/{job_id}")


def test_a_preview_goes_with_its_job(service: Service) -> None:
    job_id, waiting = service.accepted_slow(), service.accepted()
    assert service.client.get(f"/jobs/{waiting}/preview.sg").status_code == 204  # for which there cannot be one yet
    assert service.client.delete(f"/jobs/{waiting}").status_code == 204
    wait_until(lambda: any(name.startswith(f"bitstreams/{job_id}") for name in service.files()))
    assert service.client.delete(f"/jobs/{job_id}").status_code == 204
    wait_until(lambda: not any(job_id in name for name in service.files()))


def test_picture_and_bitstream_agree(service: Service, done: dict[str, Any]) -> None:
    bitstream = service.client.get(done["bitstream_url"])
    assert bitstream.status_code == 200
    assert len(bitstream.content) == done["result"]["bytes"]
    picture = service.client.get(done["decode_url"])
    assert picture.headers["content-type"] == "image/png"
    pixels = np.asarray(Image.open(io.BytesIO(picture.content)))
    np.testing.assert_array_equal(pixels, sgmethod.decode(bitstream.content))
    source = np.asarray(Image.open(io.BytesIO(SMALL)), dtype=np.float64)
    error = np.mean((pixels - source) ** 2)
    assert 10 * np.log10(255**2 / error) == pytest.approx(done["result"]["psnr"], abs=0.01)


@pytest.mark.parametrize("url", ["decode_url", "bitstream_url"])
def test_conditional_requests_and_head(service: Service, done: dict[str, Any], url: str) -> None:
    whole = service.client.get(done[url])
    etag = whole.headers["etag"]
    assert "immutable" in whole.headers["cache-control"]
    for condition in (etag, f'"other", W/{etag}', "*"):
        again = service.client.get(done[url], headers={"If-None-Match": condition})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == etag
    assert service.client.get(done[url], headers={"If-None-Match": '"other"'}).status_code == 200
    head = service.client.head(done[url])
    assert (head.status_code, head.content) == (200, b"")
    for name in ("etag", "content-type", "content-length", "cache-control"):
        assert head.headers[name] == whole.headers[name]


def test_the_two_etags_differ(service: Service, done: dict[str, Any]) -> None:
    tags = {service.client.head(done[url]).headers["etag"] for url in ("decode_url", "bitstream_url")}
    assert len(tags) == 2


def test_only_the_bitstream_is_kept(service: Service, done: dict[str, Any]) -> None:
    wait_until(lambda: [name for name in service.files() if done["id"] in name] == [f"bitstreams/{done['id']}.1.sg"])


def test_what_the_codec_refuses_fails_at_once(service: Service) -> None:
    """Such as an image with a good header, and pixels that are missing."""
    whole = png(64, 48)
    job = service.wait(service.accepted(whole[: len(whole) // 2], bpp=1))
    assert (job["state"], job["attempt"], job["result"]) == ("failed", 1, None)
    assert job["error"]["code"] == "refused"
    assert "truncated" in job["error"]["detail"]
    problem = assert_problem(service.client.get(job["decode_url"]), 409, job["error"]["detail"])
    assert problem["state"] == "failed"
    wait_until(lambda: not [name for name in service.files() if job["id"] in name])


def test_a_job_is_removed_with_its_files(quick: Service) -> None:
    service = quick
    job = service.wait(service.accepted())
    assert service.client.delete(job["status_url"]).status_code == 204
    for url in ("status_url", "decode_url", "bitstream_url"):
        assert_problem(service.client.get(job[url]), 404)
    assert_problem(service.client.delete(job["status_url"]), 404)
    assert not [name for name in service.files() if job["id"] in name]
