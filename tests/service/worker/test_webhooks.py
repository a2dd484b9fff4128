"""Webhooks, to a receiver that fails, hangs and comes back."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import hmac
import json
import threading
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import version
from typing import Any

import pytest

from service.jobs import outcomes
from service.jobs.job import JobError
from service.jobs.outcomes import Delivery
from service.jobs.table import MAX_ATTEMPTS, JobTable
from service.process.loops import PeriodicThread, StopSignal
from service.worker import webhooks
from service.worker.webhooks import headers, send_next
from tests.support.job_table import CRASH, LONG_S, RESULT, OpenTable, claimed, submitted
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import FAKE_CODEC, StartService

KEY = bytes(range(24))
SECRET = f"whsec_{base64.b64encode(KEY).decode()}"


class Receiver:
    """Takes what is posted to it, and behaves as it is set: "well", with an "error", a "redirect", "hangs" or
    "trickles"."""

    def __init__(self) -> None:
        self.behaves = "well"
        self.tries: list[str] = []
        self.taken: list[dict[str, Any]] = []
        self.released = threading.Event()
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                receiver._answer(self)

            def log_message(self, *_arguments: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/hook?token=secret"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        body = request.rfile.read(int(request.headers["Content-Length"]))
        name, at = request.headers["webhook-id"], request.headers["webhook-timestamp"]
        signed = hmac.new(KEY, f"{name}.{at}.".encode() + body, hashlib.sha256).digest()
        assert request.headers["User-Agent"] == f"sgmethod/{version('sgmethod')}"
        assert request.headers["webhook-signature"] == f"v1,{base64.b64encode(signed).decode()}"
        self.tries.append(name)
        if self.behaves == "hangs":
            self.released.wait(TIMEOUT_S)
            return
        if self.behaves == "trickles":
            request.wfile.write(b"HTTP/1.1 204 No Content\r\nX-Long: ")
            with contextlib.suppress(OSError):
                while not self.released.wait(0.05):
                    request.wfile.write(b"a")
            return
        if self.behaves == "well":
            self.taken.append(json.loads(body))
        request.send_response({"well": 204, "error": 500, "redirect": 302}[self.behaves])
        request.send_header("Location", "/elsewhere")
        request.end_headers()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    receiver = Receiver()
    yield receiver
    receiver.released.set()
    receiver.server.shutdown()
    receiver.server.server_close()


def ended(table: JobTable) -> str:
    """The id of a job that is done."""
    job_id = submitted(table)
    assert table.finish(claimed(table), RESULT)
    return job_id


def test_the_signature_of_the_standard() -> None:
    """The example that its libraries are tested with."""
    delivery = Delivery("msg_p5jXN8AQM9LWM0D4loKWxJek", "", '{"test": 2432232314}')
    named = headers(base64.b64decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"), delivery, 1614265330)
    assert named["webhook-signature"] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_a_receiver_that_fails_hangs_and_comes_back(
    open_job_table: OpenTable, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is lost, nothing delivered is sent again, and another address does not wait."""
    monkeypatch.setattr(outcomes, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(outcomes, "MAX_PAUSE_S", 0.2)
    monkeypatch.setattr(webhooks, "ANSWER_S", 0.3)
    other = Receiver()
    table, stop = open_job_table(LONG_S, webhook_urls=f"{receiver.url},{other.url}"), StopSignal()
    sends = [partial(send_next, table, url, KEY) for url in (receiver.url, other.url)]
    threads = [PeriodicThread("webhooks", send, 0.02, stop) for send in sends]
    for thread in threads:
        thread.start()
    jobs = []
    for behaviour in ("error", "redirect", "hangs", "trickles"):
        receiver.behaves = behaviour
        jobs.append(ended(table))
        before = len(receiver.tries)
        wait_until(lambda before=before: len(receiver.tries) >= before + 3)
        wait_until(lambda: {each["data"]["id"] for each in other.taken} == set(jobs))
    wait_until(lambda: table.counts().deliveries == 4)  # the other has taken the last before its sender notes that
    assert receiver.taken == []
    monkeypatch.setattr(webhooks, "ANSWER_S", TIMEOUT_S)  # what is answered late on a busy machine is not sent again
    receiver.behaves = "well"
    wait_until(lambda: table.counts().deliveries == 0)
    assert sorted(each["data"]["id"] for each in receiver.taken) == sorted(jobs)
    stop.request()
    for thread in threads:
        thread.join(TIMEOUT_S)
    other.server.shutdown()
    other.server.server_close()


def test_every_end_is_delivered_once(open_job_table: OpenTable) -> None:
    """Done, refused, crashed too often; not what goes back into the queue. The delivery outlives its job."""
    table = open_job_table(LONG_S, webhook_urls="http://a,http://b")
    done = ended(table)
    refused = submitted(table)
    assert table.fail(claimed(table), JobError("refused", "it is no picture"))
    crashed = submitted(table)
    for _ in range(MAX_ATTEMPTS):
        assert table.counts().deliveries == 4
        assert table.fail(claimed(table), CRASH)
    assert table.counts().deliveries == 6
    table.remove(done)
    bodies = {}
    while (delivery := table.due_delivery("http://a")) is not None:
        bodies[delivery.job_id] = json.loads(delivery.body)
    assert {job_id: body["type"] for job_id, body in bodies.items()} == {
        done: "job.done",
        refused: "job.failed",
        crashed: "job.failed",
    }
    assert bodies[done]["data"]["sha256"] == RESULT.sha256
    assert bodies[refused]["data"]["error"] == {"code": "refused", "detail": "it is no picture"}
    assert table.counts().deliveries == 6  # none counts as delivered


def test_pauses_grow_until_it_is_given_up(open_job_table: OpenTable, monkeypatch: pytest.MonkeyPatch) -> None:
    table = open_job_table(LONG_S, webhook_urls="http://a")
    ended(table)
    pauses = []
    for _ in range(12):
        delivery = table.due_delivery("http://a")
        assert delivery is not None
        assert table.due_delivery("http://a") is None
        with table._transaction() as db:  # type: ignore[attr-defined]
            pauses.append(db.execute("SELECT due_at - epoch() AS s FROM deliveries").fetchone()["s"])
            db.execute("UPDATE deliveries SET due_at = 0, ended_at = ended_at - ?", (pauses[-1],))
    assert [round(pause, -1) for pause in pauses[:4]] == [10, 20, 40, 80]
    assert pauses[-1] == pytest.approx(3600, abs=60)
    monkeypatch.setattr(outcomes, "RETRY_FOR_S", 0.0)
    table.register("w")
    assert table.due_delivery("http://a") is None
    assert table.counts().deliveries == 0


@pytest.mark.thorough
def test_a_service_tells_of_its_jobs(start_service: StartService, receiver: Receiver) -> None:
    service = start_service(webhook_urls=receiver.url, webhook_secret=SECRET, extra=FAKE_CODEC)
    job_id = service.accepted()
    wait_until(lambda: receiver.taken)
    (body,) = receiver.taken
    job = service.wait(job_id)
    assert (body["type"], body["data"]["id"], body["data"]["bytes"]) == ("job.done", job_id, job["result"]["bytes"])
    wait_until(lambda: service.figures()["sgmethod_webhooks_waiting"] == 0)
    assert "secret" not in service.log.read_text()
