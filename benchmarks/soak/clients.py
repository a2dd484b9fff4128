"""Clients of every kind, good and bad: each a thread that does one thing after another, with a pause between."""

from __future__ import annotations

import contextlib
import random
import socket
import threading
from abc import abstractmethod
from collections import Counter, deque
from typing import Any

import httpx
from PIL import Image

from benchmarks.load.service import made_picture, png
from tests.harness.attacks import crowded_bitstream, tiff_of_many_strips

SIZES = ((256, 192), (768, 512), (1536, 1024), (4000, 3000))
HOW_OFTEN = (8, 6, 3, 1)
VIEWS = (".png", ".png?width=800", ".webp?scale=0.5", ".jpg?width=320&height=320&fit=crop", ".avif?width=200")
PATIENCE_S = 400.0
KNOWN_JOBS = 40
IMAGE = {"Content-Type": "image/*"}


class Shared:
    """What all clients of one service share: its address, jobs that are done, and how each request was answered."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.ended = threading.Event()
        self.done: deque[str] = deque(maxlen=KNOWN_JOBS)
        self.answers: Counter[str] = Counter()
        self._lock = threading.Lock()

    def count(self, what: str) -> None:
        """Count an answer."""
        with self._lock:
            self.answers[what] += 1


class Client(threading.Thread):
    """Does one thing after another until the end. trouble: what went wrong that should not have."""

    pause_s = 1.0

    def __init__(self, shared: Shared, seed: int) -> None:
        super().__init__(name=type(self).__name__, daemon=True)
        self.shared = shared
        self.chance = random.Random(seed)
        self.http = httpx.Client(base_url=shared.url, timeout=PATIENCE_S)
        self.trouble: list[str] = []

    def run(self) -> None:
        while not self.shared.ended.wait(self.chance.expovariate(1 / self.pause_s)):
            try:
                self.do()
            except Exception as error:  # of a benchmark's own: it must be told, not end the thread
                self.trouble.append(f"{self.name}: {error!r}")
        self.http.close()

    @abstractmethod
    def do(self) -> None:
        """One thing."""

    def ask(self, method: str, path: str, **more: Any) -> httpx.Response:
        """The answer, counted by its status."""
        answer = self.http.request(method, path, **more)
        self.shared.count(f"{type(self).__name__} {answer.status_code}")
        return answer

    def a_job(self) -> str | None:
        """One that was done lately; it may be gone by now."""
        return self.chance.choice([*self.shared.done]) if self.shared.done else None


class Encodes(Client):
    """Sends pictures, waits in each of the ways that there are, encodes some again, removes some."""

    pause_s = 1.5
    images = tuple(png(Image.fromarray(made_picture(*size, seed))) for seed, size in enumerate(SIZES))

    def do(self) -> None:
        image = self.chance.choices(self.images, HOW_OFTEN)[0]
        query = {
            "bpp": self.chance.choice([0.1, 0.3]),
            "time_limit_s": 1,
            "tune": self.chance.choice(["psnr", "visual"]),
        }
        wait = {"wait": "300"} if self.chance.random() < 0.5 else {}
        answer = self.ask("POST", "/encode", content=image, params={**query, **wait}, headers=IMAGE)
        if answer.status_code == 429:
            return
        answer.raise_for_status()
        job = answer.headers["location"].rpartition("/")[2]
        if answer.status_code == 202:
            self._watch(job)
        self.shared.done.append(job)
        if self.chance.random() < 0.3:
            self.ask("POST", f"/jobs/{job}/encode?bpp=0.05&time_limit_s=1&wait=300")
        if self.chance.random() < 0.3:
            self.ask("DELETE", f"/jobs/{job}")

    def _watch(self, job: str) -> None:
        with self.http.stream("GET", f"/jobs/{job}/events") as answer:
            self.shared.count(f"{type(self).__name__} {answer.status_code}")
            for _ in answer.iter_lines():
                pass


class Looks(Client):
    """Asks for pictures, files and parts of them."""

    pause_s = 0.3

    def do(self) -> None:
        job = self.a_job()
        if job is None:
            return
        match self.chance.randrange(4):
            case 0:
                answer = self.ask("GET", f"/bitstreams/{job}.sg")
                if answer.status_code == 200:
                    self.ask("POST", "/decode?width=640", content=answer.content)
            case 1:
                self.ask("GET", f"/decode/{job}.png", headers={"Range": "bytes=100-999"})
                self.ask("HEAD", f"/decode/{job}.png")
            case _:
                self.ask("GET", f"/decode/{job}{self.chance.choice(VIEWS)}")


class Watches(Client):
    """Operators and pages: lists, figures, streams that are left early."""

    pause_s = 1.0

    def do(self) -> None:
        self.ask(
            "GET", self.chance.choice(["/jobs?limit=200", "/jobs?state=done", "/metrics", "/readyz", "/", "/docs"])
        )
        job = self.a_job()
        if job is not None:
            self.ask("GET", f"/jobs/{job}")
            with self.http.stream("GET", f"/jobs/{job}/events") as answer:
                next(answer.iter_lines(), None)


class Harms(Client):
    """Damaged and hostile files, requests cut short, other protocols."""

    pause_s = 2.0
    hostile = (tiff_of_many_strips(200_000), b"", b"GIF89a" + bytes(100), Encodes.images[1][:5000])
    crowded = crowded_bitstream()

    def do(self) -> None:
        match self.chance.randrange(5):
            case 0 | 1:
                # It waits for its job, as the others do: how much is asked for follows how fast the machine is.
                query = {"bpp": 0.3, "time_limit_s": 1, "wait": 300}
                self.ask("POST", "/encode", content=self.chance.choice(self.hostile), params=query, headers=IMAGE)
            case 2:
                self._raw(
                    b"POST /decode HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(self.crowded) + self.crowded
                )
            case 3:
                self._raw(
                    b"POST /encode HTTP/1.1\r\nHost: x\r\nContent-Type: image/png\r\nContent-Length: 900000\r\n\r\n"
                    + bytes(99_999)
                )
            case _:
                self._raw(b"GET /jobs HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n")
                self._raw(b"\x16\x03\x01 no HTTP\r\n\r\n")

    def _raw(self, words: bytes) -> None:
        """Say it, and hang up soon."""
        url = httpx.URL(self.shared.url)
        with contextlib.suppress(OSError), socket.create_connection((url.host, url.port or 80), 10) as connection:
            connection.sendall(words)
            connection.settimeout(self.chance.uniform(0.05, 1.0))
            self.shared.count(f"{type(self).__name__} {(connection.recv(12).split() or [b'', b'closed'])[-1].decode()}")
