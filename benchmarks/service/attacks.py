"""Latency of other clients, and memory of the web process, during attacks.

    python -m benchmarks.service attacks [--seconds 60] [--only tiff,decode] [--out FILE]

Each attack meets a fresh `python -m service web` with default settings but a long queue, in which jobs of other
clients may wait, behind the nginx of docs/nginx.conf (without TLS). The attackers (benchmarks.service.attackers) send
requests as fast as they are answered, from one address or several. A client at another address sends seven kinds of
requests at fixed moments. Attacks have ten times as many clients as tests/service/api, or files of the
largest size allowed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.arguments import some_of
from benchmarks.machine import ROOT, RUNS, Record, peak_bytes
from benchmarks.service.attackers import ATTACKS
from benchmarks.service.generator import Request, send_all
from benchmarks.service.uploads import made_picture
from tests.support.nginx import Nginx, make_certificate
from tests.support.service import Service

VICTIM = "127.0.0.2"
LIMITS = {"p99_ms": 1000, "web_mb": 400}
FILE = ROOT / "service" / "page" / "samples" / "cat.sg"
# No worker runs, so jobs of the other client wait.
SETTINGS: dict[str, Any] = {
    "queue_length": 1_000_000,
    "source_retention_s": 3600,
}
WARM_S, LONGER_S = 3.0, 3.0


def requests(job: str, waiting: str) -> dict[str, Request]:
    """The requests of the other client, by name in the results."""
    return {
        "GET /livez": Request(10, "GET", "/livez"),
        "GET /readyz": Request(2, "GET", "/readyz"),
        "GET /jobs/ID": Request(5, "GET", f"/jobs/{waiting}"),
        "GET /bitstreams/ID.sg": Request(5, "GET", f"/bitstreams/{job}.sg"),
        "GET /decode/ID.png": Request(5, "GET", f"/decode/{job}.png"),
        "POST /decode": Request(5, "POST", "/decode", FILE.read_bytes()),
        "POST /encode": Request(5, "POST", "/encode", made_picture(256, 192)),
    }


def measure(name: str, seconds: float) -> dict[str, Any]:
    """The row of one attack."""
    attack = ATTACKS[name]
    with tempfile.TemporaryDirectory(prefix="sg-attack-") as temporary:
        service = Service(Path(temporary) / "data", "web", trusted_proxies="127.0.0.1", **SETTINGS)
        proxy = Nginx(Path(temporary), make_certificate(Path(temporary)), [service.url], tls=False)
        try:
            job, waiting = service.published(FILE.read_bytes()), service.accepted()
            others = requests(job, waiting)
            send_all(proxy.url, WARM_S, [*others.values()], VICTIM)
            attacked = job if name == "untaken" else waiting
            with _attackers(name, proxy.url, seconds + LONGER_S, attacked) as attackers:
                assert attackers.stdout is not None
                assert attackers.stdout.readline() == "ready\n"
                time.sleep(1)
                spreads = send_all(proxy.url, seconds, [*others.values()], VICTIM)
                answers = json.loads(attackers.communicate()[0])
            web_mb = round(peak_bytes(service.process.pid) / 1e6, 1)
        finally:
            proxy.stop()
            status = service.stop()
        log = service.log.read_text()
    worst_ms = max(spread["p99_ms"] for spread in spreads)
    failed = sum(spread["failed"] for spread in spreads)
    took_place = sum(answers.values()) >= attack.at_once  # or this machine had no core for the attackers
    return {
        **{"attack": name, "words": attack.words, "at_once": attack.at_once, "answers": answers},
        **{"others": dict(zip(others, spreads, strict=True)), "others_failed": failed, "others_worst_p99_ms": worst_ms},
        **{"web_mb": {"most": web_mb}, "tracebacks": log.count("Traceback"), "exit_status": status},
        "met": failed == 0 and worst_ms <= LIMITS["p99_ms"] and web_mb <= LIMITS["web_mb"] and took_place,
    }


def _attackers(name: str, url: str, seconds: float, job: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "benchmarks.service.attackers", name, url.removeprefix("http://")]
    return subprocess.Popen([*command, str(seconds), job], cwd=ROOT, stdout=subprocess.PIPE, text=True)


def main() -> int:
    """Exit status: 0 if other clients were served in time and memory stayed small, whatever the attack."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each attack (default: 60)")
    parser.add_argument(
        "--only",
        type=some_of(ATTACKS, "attack"),
        default=",".join(ATTACKS),
        help="attacks, apart by commas (default: all)",
    )
    parser.add_argument("--out", type=Path, default=RUNS / "service" / "attacks.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.service attacks", {"seconds": options.seconds, "at_most": LIMITS})
    for name in options.only:
        if not record.has(attack=name):
            record.add(measure(name, options.seconds))
    return 0 if all(row["met"] for row in record.rows) else 1
