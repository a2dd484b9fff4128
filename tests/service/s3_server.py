"""Servers that speak S3, for tests: moto's, which forgets all when it ends, and rclone's, which does not."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

from benchmarks.harness.processes import PATIENCE_S, wait_until

KEY = "test"


class S3Server:
    """One server with one bucket. environment: how obstore reaches it."""

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        self._buckets = 0
        self.environment = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self._port}",
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": KEY,
            "AWS_REGION": "us-east-1",
        }
        self.start()

    def start(self) -> None:
        """Start it; it answers when this returns, and has forgotten everything."""
        self._process = subprocess.Popen(self._command(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_until(self._answers)

    def _command(self) -> list[str]:
        return [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self._port)]

    def _answers(self) -> bool:
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{self._port}/", timeout=PATIENCE_S).close()
        except urllib.error.HTTPError:  # which rclone answers those with who do not sign
            return True
        except OSError:  # one that comes before it has begun to answer
            return False
        return True

    def new_storage(self) -> str:
        """SG_STORAGE_URL of a new, empty bucket, beneath a prefix."""
        self._buckets += 1
        bucket = f"pictures{self._buckets}"
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/{bucket}", method="PUT")
        urllib.request.urlopen(request, timeout=PATIENCE_S).close()
        return f"s3://{bucket}/sgmethod"

    def freeze(self) -> None:
        """From now on connections are accepted, by the system, and nothing is ever answered."""
        self._process.send_signal(signal.SIGSTOP)

    def stop(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()


class KeptS3Server(S3Server):
    """One whose objects are files of a folder, and are still there after a restart."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        super().__init__()

    def _command(self) -> list[str]:
        rclone = str(Path(sys.executable).with_name("rclone"))
        address = f"127.0.0.1:{self._port}"
        return [rclone, "serve", "s3", "--addr", address, "--auth-key", f"{KEY},{KEY}", str(self._folder)]

    def new_storage(self) -> str:
        (self._folder / "pictures").mkdir(parents=True)
        return "s3://pictures/sgmethod"
