"""nginx as docs/nginx.conf sets it up, in front of services of a test or a benchmark."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import httpx2

from tests.support.data import ROOT
from tests.support.processes import TIMEOUT_S, free_port, wait_until

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
REQUIRED = "SGMETHOD_TEST_NGINX"  # set to "required", a missing nginx fails the tests
HINT = "nginx is not installed, so nothing was tested behind it: sudo apt install nginx"
DOCUMENTED = ROOT / "docs" / "nginx.conf"
AROUND = """
daemon off; {user} pid {folder}/pid; error_log {folder}/error.log; worker_rlimit_nofile 8192;
events {{ worker_connections 4096; }}
http {{
    access_log off; include /etc/nginx/mime.types;
    client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
    {documented}
}}
"""


def make_certificate(folder: Path) -> Path:
    """A certificate for this machine, beside its key."""
    file = folder / "certificate.pem"
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-days", "2"]
    kind = ["-x509", "-nodes", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
    files = ["-out", str(file), "-keyout", str(folder / "key.pem")]
    subprocess.run(["openssl", "req", *kind, *names, *files], check=True, capture_output=True)
    return file


class Nginx:
    """The documented nginx before one or two web processes, ready when it is made.

    certificate: of make_certificate(), which SSL_CERT_FILE names; prefix: a path under which it serves them; changes:
    texts of the file to replace, such as a time that a test does not want to wait for; tls: or plain HTTP.
    """

    def __init__(
        self,
        folder: Path,
        certificate: Path,
        webs: Sequence[str],
        prefix: str = "",
        changes: Mapping[str, str] | None = None,
        *,
        tls: bool = True,
    ) -> None:
        self.port = free_port()
        self.folder = folder  # of its logs
        first, *second = [web.removeprefix("http://") for web in webs]
        text = DOCUMENTED.read_text()
        replaced = {
            "listen 443 ssl": f"listen 127.0.0.1:{self.port} ssl",
            "127.0.0.1:8000": first,
            **({"# server 127.0.0.1:8001": f"server {second[0]}"} if second else {}),
            "/etc/nginx/tls": str(certificate.parent),
            "/var/log/nginx": str(folder),
            **({} if tls else {"ssl http2;": ";"}),
            **(changes or {}),
        }
        if prefix:
            replaced |= {"location / {": f"location {prefix}/ {{", "= /metrics": f"= {prefix}/metrics"}
            text = text.replace("http://sgmethod;", "http://sgmethod/metrics;").replace(
                "http://sgmethod/metrics;", "http://sgmethod/;", 1
            )
        for old, new in replaced.items():
            assert old in text, old
            text = text.replace(old, new)
        user = "user root;" if os.geteuid() == 0 else ""  # no other may enter the folder
        (folder / "nginx.conf").write_text(AROUND.format(folder=folder, documented=text, user=user))
        command = [str(NGINX), "-c", str(folder / "nginx.conf"), "-e", str(folder / "error.log")]
        self._process = subprocess.Popen(command)
        self.url = f"{'https' if tls else 'http'}://127.0.0.1:{self.port}{prefix}"
        wait_until(self._answers)

    def _answers(self) -> bool:
        try:
            return httpx2.get(f"{self.url}/livez").is_success
        except httpx2.TransportError:
            return False

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait(TIMEOUT_S)
