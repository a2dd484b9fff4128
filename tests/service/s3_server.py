"""A server that speaks S3, for tests: rclone's."""

from __future__ import annotations

import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

from tests.support.processes import TIMEOUT_S, free_port, wait_until

KEY, BUCKET = "test", "pictures"


class S3Server:
    """A server with one bucket, a folder within `folder`, which is there after a restart. environment: for clients."""

    def __init__(self, folder: Path) -> None:
        (folder / BUCKET).mkdir(parents=True)
        address = f"127.0.0.1:{free_port()}"
        self._url = f"http://{address}"
        rclone = str(Path(sys.executable).with_name("rclone"))
        self._command = [rclone, "serve", "s3", "--addr", address, "--auth-key", f"{KEY},{KEY}", str(folder)]
        self._storages = 0
        self.environment = {
            "AWS_ENDPOINT_URL": self._url,
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": KEY,
            "AWS_REGION": "us-east-1",
        }
        self.start()

    def start(self) -> None:
        """Start it; it answers when this returns."""
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_until(self._answers)

    def _answers(self) -> bool:
        try:
            urllib.request.urlopen(self._url, timeout=TIMEOUT_S).close()
        except urllib.error.HTTPError:  # the answer to a request without a signature
            return True
        except OSError:  # it has not begun to answer
            return False
        return True

    def new_storage(self) -> str:
        """SG_STORAGE_URL of an empty storage: each has a prefix of its own."""
        self._storages += 1
        return f"s3://{BUCKET}/sgmethod{self._storages}"

    def freeze(self) -> None:
        """From now on connections are accepted, by the system, and nothing is ever answered."""
        self._process.send_signal(signal.SIGSTOP)

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()
