"""API keys: who may see and do what, and links for those without a key."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import pytest

from service.api.sending import MAX_CACHED_S
from service.keys import KeyRing, Link, digest, parse_keys
from service.settings import Settings
from tests.support.data import PICTURE
from tests.support.pictures import SMALL
from tests.support.processes import TIMEOUT_S, run, wait_until
from tests.support.service import RunCommand, Service, StartService, assert_problem, bearer, max_age

SECRET = "0123456789abcdef" * 2
ANN, BOB = "key-of-ann", "key-of-bob"
KEYS = f"ann:{digest(ANN)},bob:{digest(BOB)}"


@pytest.fixture(scope="module")
def guarded(start_for_module: StartService, new_table: Callable[[], str]) -> Service:
    """A web process that knows ann and bob."""
    service = start_for_module("web", api_keys=KEYS, link_secret=SECRET, database_url=new_table())
    service.wait_ready()
    return service


@pytest.fixture
def ann(guarded: Service) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=guarded.url, headers=bearer(ANN), timeout=TIMEOUT_S) as client:
        yield client


@pytest.fixture
def bob(guarded: Service) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=guarded.url, headers=bearer(BOB), timeout=TIMEOUT_S) as client:
        yield client


def post(client: httpx2.Client, **headers: str) -> httpx2.Response:
    return client.post("/encode?bpp=1", content=SMALL, headers={"Content-Type": "image/png", **headers})


def test_keys_are_read() -> None:
    a, b, c = digest("a"), digest("b"), digest("c")
    text = f" ann:{a}, bob:{b}  # of the first floor\n# carl:x\n\nann:{c}\n"
    assert parse_keys(text) == {a: "ann", b: "bob", c: "ann"}
    assert parse_keys("") == {}
    for wrong in ("ann", f":{a}", f"ann:{a[:-1]}", f"ann:{a.upper()}", f"an n:{a}", f"ann:{a};bob:{b}", "ann:secret"):
        with pytest.raises(ValueError, match=r"^key [12] must be a name") as refusal:
            parse_keys(wrong)
        assert "secret" not in str(refusal.value)  # it might be one


def test_a_new_key_works(tmp_path: Path) -> None:
    names = ("carol", "no name", "--help")  # the last printed a key of that name
    made, refused, asked = (run(sys.executable, "-m", "service.keys", name) for name in names)
    assert (made.status, refused.status, asked.status) == (0, 2, 0)
    assert "NAME" in asked.stdout and "key:" not in asked.stdout
    key, line = (text.partition(": ")[2] for text in made.stdout.splitlines())
    file = tmp_path / "keys"
    file.write_text(f"# customers\n{KEYS}\n{line}\n")
    ring = KeyRing(Settings(api_keys_file=file).key_names)
    assert (ring.owner_of(key), ring.owner_of(ANN)) == ("carol", "ann")
    assert key not in line


def test_key_files_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be read"):
        Settings(api_keys_file=tmp_path / "nowhere")
    (tmp_path / "empty").write_text("# no key yet\n")
    with pytest.raises(ValueError, match="contains no key"):  # and not: open to all
        Settings(api_keys_file=tmp_path / "empty")
    with pytest.raises(ValueError, match="32 characters"):
        Settings.model_validate({"link_secret": "short"})


@pytest.mark.parametrize(
    "authorization",
    ["", "Bearer", "Bearer wrong", f"Basic {ANN}", f"Bearer {digest(ANN)}", f"Bearer {ANN} {BOB}", ANN, "Bearer \xff"],
)
@pytest.mark.parametrize("path", ["/jobs", "/jobs/x", "/decode/x.png", "/metrics", "/encode", "/no/such"])
def test_without_a_good_key(guarded: Service, authorization: str, path: str) -> None:
    headers = {"Authorization": authorization.encode("latin-1")} if authorization else {}
    answer = guarded.client.request("POST" if path == "/encode" else "GET", path, headers=headers)
    assert_problem(answer, 401)
    assert answer.headers["www-authenticate"] == "Bearer"


def test_a_key_for_prometheus_reads_metrics_alone(start_service: StartService) -> None:
    """The key in its configuration could remove jobs."""
    web = start_service("web", api_keys=f"{KEYS},metrics:{digest('of-prometheus')}")
    web.client.headers.update(bearer("of-prometheus"))
    assert web.client.get("/metrics").status_code == 200
    assert web.client.get("/livez").status_code == 200
    for method, path in (("GET", "/jobs"), ("POST", "/encode"), ("POST", "/decode.png"), ("GET", "/metrics/x")):
        assert_problem(web.client.request(method, path), 403, "/metrics alone")


@pytest.mark.parametrize("path", ["/", "/docs", "/livez", "/readyz", "/openapi.json", "/static/main.js"])
def test_what_needs_no_key(guarded: Service, path: str) -> None:
    assert guarded.client.get(path).status_code == 200


@pytest.mark.parametrize(
    "path", ["/static/../jobs", "/static/%2e%2e/jobs", "/static/..%2fjobs", "/livez/../jobs", "//jobs"]
)
def test_no_way_around_the_key(guarded: Service, path: str) -> None:
    request = httpx2.Request("GET", guarded.url)
    request.url = httpx2.URL(guarded.url).copy_with(raw_path=path.encode())
    assert guarded.client.send(request).status_code in (401, 404)


def test_jobs_are_their_owners_alone(guarded: Service, ann: httpx2.Client, bob: httpx2.Client) -> None:
    mine, theirs = (post(client, **{"Idempotency-Key": "one"}).json() for client in (ann, bob))
    assert mine["id"] != theirs["id"]
    done = guarded.published(PICTURE, "ann")
    assert ann.get(mine["status_url"]).status_code == 200
    assert ann.get(f"/decode/{done}.png").status_code == 200
    for job_id in (mine["id"], done):
        for path in ("/jobs/{}", "/decode/{}.png", "/bitstreams/{}.sg"):
            assert_problem(bob.get(path.format(job_id)), 404)
        assert_problem(bob.delete(f"/jobs/{job_id}"), 404)
        assert_problem(bob.post(f"/jobs/{job_id}/links"), 404)
        assert ann.get(f"/jobs/{job_id}").status_code == 200
    assert {mine["id"], done} <= {job["id"] for job in ann.get("/jobs").json()["jobs"]}
    assert not {mine["id"], done} & {job["id"] for job in bob.get("/jobs").json()["jobs"]}


def test_one_owner_cannot_fill_the_queue(start_service: StartService) -> None:
    web = start_service("web", api_keys=KEYS, queue_length=4)
    web.client.headers.update(bearer(ANN))
    accepted = [web.post(key=key) for key in ("a", "b")]
    refused = web.post(key="c")
    assert_problem(refused, 429, "2 jobs")
    assert refused.headers["retry-after"]
    assert web.post(key="a").json() == accepted[0].json()
    web.client.headers.update(bearer(BOB))
    assert web.post(key="c").status_code == 202
    assert len(web.files()) == 3


def test_a_body_is_not_read_without_a_key(guarded: Service) -> None:
    head = b"POST /encode?bpp=1 HTTP/1.1\r\nHost: localhost\r\nContent-Type: image/png\r\n"
    answer = guarded.raw(head + b"Content-Length: 1000000\r\nExpect: 100-continue\r\nConnection: close\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 401 ")  # and not "100 Continue" first


def test_links(guarded: Service, ann: httpx2.Client, bob: httpx2.Client) -> None:
    done = guarded.published(PICTURE, "ann")
    links = ann.post(f"/jobs/{done}/links?expires_s=50").json()
    anyone = guarded.client
    picture = anyone.get(links["decode_url"])
    assert picture.content == ann.get(f"/decode/{done}.png").content
    assert anyone.get(links["decode_url"]).content == picture.content  # as often as one likes, until it expires
    assert anyone.head(links["decode_url"]).status_code == 200
    assert anyone.get(links["decode_url"].replace(".png", ".webp") + "&width=10").status_code == 200
    assert anyone.get(links["bitstream_url"]).content == PICTURE
    assert bob.get(links["bitstream_url"]).status_code == 404  # a key speaks for its owner, whatever the link

    query = links["decode_url"].partition("?")[2]
    other = guarded.published(PICTURE, "ann")
    assert_problem(anyone.get(f"/decode/{other}.png?{query}"), 401, "not valid")
    assert_problem(anyone.get(f"/bitstreams/{done}.sg?{query}"), 401, "not valid")
    assert_problem(anyone.get(f"/jobs/{done}?{query}"), 401)
    assert_problem(anyone.delete(f"/jobs/{done}?{query}"), 401)
    assert_problem(anyone.post(f"/decode/{done}.png?{query}"), 401)
    assert_problem(anyone.get(links["decode_url"].replace("expires=", "expires=9")), 401, "not valid")
    assert_problem(anyone.get(links["decode_url"][:-1]), 401, "not valid")
    assert_problem(anyone.get(f"/decode/{done}.png?signature=" + "0" * 64), 401, "not valid")
    assert_problem(anyone.get(f"/decode/{done}.png?expires=x&signature=ü"), 401, "not valid")

    ann.delete(f"/jobs/{done}")
    assert_problem(anyone.get(links["decode_url"]), 404)


def test_links_expire(guarded: Service, ann: httpx2.Client) -> None:
    """In a week at the latest."""
    done = guarded.published(PICTURE, "ann")
    late, soon = (Link("decode", done, int(time.time()) + seconds).query(SECRET) for seconds in (-1, 50))
    assert_problem(guarded.client.get(f"/decode/{done}.png?{late}"), 401, "expired")
    answer = guarded.client.get(f"/decode/{done}.png?{soon}")
    assert 0 < max_age(answer) <= 50  # no cache keeps it for longer than the link holds
    assert max_age(ann.get(f"/decode/{done}.png")) == MAX_CACHED_S
    foreign = Link("decode", done, int(time.time()) + 50).query("another secret")
    assert_problem(guarded.client.get(f"/decode/{done}.png?{foreign}"), 401, "not valid")
    assert ann.post(f"/jobs/{done}/links?expires_s=604800").status_code == 200
    for wrong in ("604801", "0", "-1", "x", "9" * 30):
        assert_problem(ann.post(f"/jobs/{done}/links?expires_s={wrong}"), 422)


def test_no_links_without_a_secret(web: Service) -> None:
    assert_problem(web.client.post(f"/jobs/{web.published(PICTURE)}/links"), 404, "not enabled")


def test_others_are_let_in_by_keys_or_by_name(run_command: RunCommand, tmp_path: Path) -> None:
    result = run_command("web", host="0.0.0.0", port=0, data_dir=tmp_path)
    assert (result.status, result.stdout) == (1, "")
    assert "cannot start: SG_HOST=0.0.0.0: others could" in result.stderr


@pytest.mark.thorough
def test_all_addresses_are_those_of_ipv4_too(start_service: StartService) -> None:
    """With :: it refused IPv4, by which the image's health check asks; a proxy's address has another form there."""
    if not socket.has_dualstack_ipv6():
        pytest.skip("this machine has no IPv6")
    web = start_service("web", host="::", host_names="pictures.example", trusted_proxies="127.0.0.0/8")
    port = httpx2.URL(web.url).port
    assert httpx2.get(f"http://[::1]:{port}/livez").status_code == 200
    answer = httpx2.get(f"http://127.0.0.1:{port}/livez?x", headers={"X-Forwarded-For": "9.9.9.9"})
    assert_problem(answer, 422)
    wait_until(lambda: " bytes, 9.9.9.9 invalid" in web.log.read_text())


@pytest.mark.parametrize("settings", [{"api_keys": KEYS}, {"host_names": "pictures.example"}], ids=["keys", "names"])
def test_others_are_let_in(start_service: StartService, settings: dict[str, str]) -> None:
    assert start_service("web", host="0.0.0.0", **settings).client.get("/livez").status_code == 200


SITES = [  # Host, Origin, the answers to a GET and to a POST
    ("localhost:8000", None, 200, 422),
    ("127.0.0.1", None, 200, 422),
    ("[::1]:8000", None, 200, 422),
    ("evil.example", None, 421, 421),
    ("localhost.evil.example", None, 421, 421),
    ("[", None, 421, 421),
    ("pictures.example", "https://pictures.example", 200, 422),
    ("localhost:8000", "http://localhost:8000", 200, 422),
    ("localhost:8000", "http://localhost:9000", 200, 403),
    ("localhost:8000", "https://evil.example", 200, 403),
    ("localhost:8000", "null", 200, 403),
    ("localhost:8000", "https://friend.example", 200, 422),
]


@pytest.fixture(scope="module")
def named(start_for_module: StartService) -> Service:
    """A web process without keys, which has a name and a friend."""
    service = start_for_module("web", host_names="Pictures.example", cors_origins="https://friend.example")
    service.wait_ready()
    return service


@pytest.mark.parametrize(("host", "origin", "get", "post"), SITES)
def test_pages_of_other_sites_are_kept_out(named: Service, host: str, origin: str | None, get: int, post: int) -> None:
    """A name that leads to this machine is enough to read jobs from elsewhere, and a form to start some."""
    headers = {"Host": host, **({} if origin is None else {"Origin": origin})}
    assert named.client.get("/jobs", headers=headers).status_code == get
    assert named.client.post("/decode", content=b"nothing", headers=headers).status_code == post


@pytest.mark.parametrize("method", ["GET", "HEAD"])
@pytest.mark.parametrize("path", ["/livez", "/readyz"])
def test_probes_of_http_1_0_name_no_host(named: Service, method: str, path: str) -> None:
    assert named.raw(f"{method} {path} HTTP/1.0\r\n\r\n".encode()).startswith(b"HTTP/1.1 200 ")


def test_keys_keep_out_whom_they_do_not_let_in(ann: httpx2.Client) -> None:
    """So any name will do."""
    assert ann.get("/jobs", headers={"Host": "any.example"}).status_code == 200
    assert ann.post("/decode", content=b"", headers={"Origin": "https://any.example"}).status_code == 422


def test_two_keys_are_none(ann: httpx2.Client) -> None:
    for second in (f"Bearer {ANN}", "Basic eDp5"):
        assert_problem(ann.get("/jobs", headers=[("Authorization", f"Bearer {ANN}"), ("Authorization", second)]), 401)
