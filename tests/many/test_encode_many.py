"""sgmethod.encode_many() and its manifest: what is skipped, what is made again, and a run that is killed."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from sgmethod import Budget, ImageWarning, Row, SgError, Tally, encode, encode_many
from sgmethod.client import RemoteEncoded, encode_many as encode_on_server
from sgmethod.errors import noted
from sgmethod.io.image import warn
from sgmethod.many.manifest import Manifest
from tests.many.killing import Killer
from tests.support.pictures import photo
from tests.support.processes import wait_until
from tests.support.profiles import shorten

PHOTO = Image.fromarray(photo()).resize((64, 48))


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with three pictures, and encodes of a tenth of a second."""
    monkeypatch.chdir(tmp_path)
    shorten(monkeypatch, 20)
    for number in range(3):
        PHOTO.rotate(90 * number).save(f"{number}.png")


def paths() -> list[Path]:
    return sorted(Path().glob("*.png"))


def rows(folder: str = "out") -> list[dict[str, Any]]:
    return [json.loads(line) for line in (Path(folder) / "manifest.jsonl").read_text().splitlines()]


def many(**more: Any) -> Tally:
    return encode_many(paths(), "out", gaussians=9, **more)


def counts(tally: Tally) -> tuple[int, int, int]:
    return tally.encoded, tally.skipped, tally.failed


def test_every_picture_is_a_file_and_a_line() -> None:
    Path("bad.png").write_bytes(b"hello")
    seen: list[tuple[Row, Tally]] = []
    tally = many(on_row=lambda *now: seen.append(now))
    assert counts(tally) == (3, 0, 1)
    assert [row["name"] for row in rows()] == ["0.sg", "1.sg", "2.sg", "bad.sg"]
    assert [row.name for row, _ in seen] == [row["name"] for row in rows()]
    for row in rows()[:3]:
        encoded = encode(row["input"], gaussians=9)
        assert (Path("out") / row["name"]).read_bytes() == encoded.data
        assert row["bytes"] == row["figures"]["bytes"] == len(encoded.data)
        assert (row["figures"]["psnr"], row["error"]) == (encoded.stats.psnr, None)
    assert rows()[3]["error"].startswith("the file is not a PNG")
    assert tally.bytes == sum(row["bytes"] for row in rows())
    assert tally.files == 4
    assert seen[1][1].seconds_left == pytest.approx(seen[1][1].seconds)
    assert seen[1][1].per_second == pytest.approx(2 / seen[1][1].seconds)


def test_what_is_done_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    assert counts(many()) == (3, 0, 0)
    assert counts(many(resume=True)) == (0, 3, 0)
    assert len(rows()) == 3
    assert counts(many(resume=True, tune="psnr")) == (3, 0, 0)  # other options
    assert counts(many(resume=True)) == (3, 0, 0)
    Path("out/0.sg").unlink()
    Path("out/1.sg").write_bytes(b"cut off")
    PHOTO.resize((50, 40)).save("2.png")
    assert counts(many(resume=True)) == (3, 0, 0)
    assert counts(many(resume=True)) == (0, 3, 0)
    assert counts(many()) == (3, 0, 0)  # without resume
    assert counts(many(on_progress=lambda _: None)) == (3, 0, 0)
    assert counts(many(resume=True, on_progress=lambda _: None)) == (0, 3, 0)  # another function
    monkeypatch.setattr("sgmethod.many.manifest.version", lambda _: "9.9")
    assert counts(many(resume=True)) == (3, 0, 0)


def test_failures_are_tried_again() -> None:
    Path("1.png").write_bytes(b"hello")
    assert counts(many(resume=True)) == (2, 0, 1)
    assert counts(many(resume=True)) == (0, 2, 1)
    PHOTO.save("1.png")
    assert counts(many(resume=True)) == (1, 2, 0)
    Path("1.png").unlink()
    missing = ["0.png", "1.png", "2.png"]
    assert counts(encode_many(missing, "out", resume=True, gaussians=9)) == (0, 2, 1)
    assert "No such file" in rows()[-1]["error"]


def test_pictures_in_memory() -> None:
    array = np.asarray(PHOTO)

    def items() -> Iterator[tuple[str, Any]]:
        yield "array", array
        yield "path", Path("0.png")
        yield "bytes", Path("0.png").read_bytes()
        yield "wrong", np.zeros((2, 2), np.complex64)
        yield "pages", Image.fromarray(np.dstack([array, array[..., 0]]))

    tally = encode_many(items(), "out", gaussians=9, profile="rd")
    assert counts(tally) == (4, 0, 1)
    assert (tally.files, tally.seconds_left) == (None, None)
    assert [row["input"] for row in rows()] == [None, "0.png", None, None, None]
    assert Path("out/array.sg").read_bytes() == Path("out/path.sg").read_bytes() == Path("out/bytes.sg").read_bytes()
    assert counts(encode_many(items(), "out", resume=True, gaussians=9, profile="rd")) == (0, 4, 1)


def test_what_is_dropped_is_in_the_line() -> None:
    PHOTO.save("moves.gif", save_all=True, append_images=[PHOTO.rotate(180)])
    encode_many(["moves.gif"], "out", gaussians=9)
    assert rows()[0]["notes"] == ["only the first of several pictures is used"]


def test_each_thread_has_its_own_notes() -> None:
    all_note, notes = threading.Barrier(2), {}

    def work(name: str) -> None:
        with noted() as notes[name]:
            all_note.wait(60)
            warn([name])
            all_note.wait(60)

    threads = [threading.Thread(target=work, args=(name,)) for name in ("first", "second")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert notes == {"first": ["first"], "second": ["second"]}
    with pytest.warns(ImageWarning, match="third"):
        warn(["third"])


def test_warnings_of_others_are_no_notes() -> None:
    with noted() as notes, pytest.warns(UserWarning, match="other"):
        warnings.warn("other", UserWarning, stacklevel=1)
    assert notes == []


@pytest.mark.parametrize("name", ["", "a/b", "/a", "a\0", 7])
def test_names_that_are_none(name: Any) -> None:
    with pytest.raises(SgError, match="file name"):
        encode_many([(name, PHOTO)], "out", gaussians=9)


def test_a_name_that_is_taken_keeps_its_extension() -> None:
    PHOTO.save("0.jpg")
    for encoded, skipped in ((3, 0), (0, 3)):
        tally = encode_many(["0.png", "0.jpg", "1.png"], "out", resume=True, gaussians=9)
        assert (tally.encoded, tally.skipped) == (encoded, skipped)
    assert [row["name"] for row in rows()] == ["0.sg", "0.jpg.sg", "1.sg"]
    encode_many([("0", PHOTO), "0.jpg"], "pairs", gaussians=9)
    assert {path.name for path in Path("pairs").glob("*.sg")} == {"0.sg", "0.jpg.sg"}


def test_what_ends_the_run() -> None:
    for again in ("0.png", ("0", PHOTO)):
        with pytest.raises(SgError, match=r"would both become out/0\.sg: give other names"):
            encode_many(["0.png", again], "out", gaussians=9)
        assert [row["name"] for row in rows()] == ["0.sg"]
        Path("out/manifest.jsonl").unlink()
    for jobs in (0, 257, 1.5):
        with pytest.raises(SgError, match="the number of jobs must be"):
            many(jobs=jobs)
    with pytest.raises(TypeError, match="qualty"):
        many(qualty=3)
    for one in ("0.png", b"0.png", Path("0.png")):
        with pytest.raises(SgError, match="pictures are given as a list, such as"):
            encode_many(one, "one")  # type: ignore[arg-type]
    assert not Path("one").exists()
    Path("folder/manifest.jsonl").mkdir(parents=True)
    with pytest.raises(SgError, match=r"^cannot write folder/manifest\.jsonl: Is a directory$"):
        encode_many(paths(), "folder", gaussians=9)


def test_nothing_waits_for_a_busy_server_after_an_error() -> None:
    """And what the server answers then changes no file: the next run may have written it."""
    calls, free, threads = itertools.count(), threading.Event(), []

    def encode(*_: object, **__: object) -> RemoteEncoded:
        threads.append(threading.current_thread())
        if next(calls) == 0:
            return RemoteEncoded(b"", {}, [], [])
        free.wait(60)
        return RemoteEncoded(b"late", {}, [], [])

    with pytest.raises(KeyboardInterrupt):
        encode_on_server(Mock(encode=encode), paths(), "out", jobs=2, on_row=Mock(side_effect=KeyboardInterrupt))
    assert sorted(path.stat().st_size for path in Path("out").glob("*.sg")) == [0]
    free.set()
    for thread in threads:
        thread.join(60)
    assert sorted(path.stat().st_size for path in Path("out").glob("*.sg")) == [0]


def test_an_executor_makes_the_same_files() -> None:
    """And the same manifest; it is not shut down, and a run that resumes makes nothing twice."""
    Path("bad.png").write_bytes(b"hello")
    pictures = [*paths(), ("array", np.asarray(PHOTO)), "missing.png"]
    with ThreadPoolExecutor(2) as executor:
        assert counts(encode_many(pictures, "out", executor=executor, gaussians=9)) == (4, 0, 2)
        assert counts(encode_many(pictures, "out", executor=executor, resume=True, gaussians=9)) == (0, 4, 2)
        with pytest.raises(TypeError, match="qualty"):
            many(executor=executor, qualty=3)
    errors = {row["name"]: row["error"] for row in rows()}
    assert errors["bad.sg"].startswith("the file is not a PNG")
    assert "No such file" in errors["missing.sg"]
    encode_many(pictures[:3], "alone", gaussians=9)
    for name in ("0.sg", "1.sg", "2.sg"):
        assert Path("out", name).read_bytes() == Path("alone", name).read_bytes()
    for wrong in (2, "dask", ThreadPoolExecutor):
        with pytest.raises(SgError, match=r"^an executor must be a concurrent\.futures\.Executor, not "):
            many(executor=wrong)


@pytest.mark.parametrize("killer", [Killer(), b"hello"])
def test_a_picture_that_ends_its_process_is_one_that_fails(killer: Any) -> None:
    tally = encode_many([("bad", killer), *paths(), ("last", PHOTO)], "out", jobs=2, gaussians=9, effort=1)
    assert counts(tally) == (4, 0, 1)
    errors = {row["name"]: row["error"] for row in rows()}
    assert errors.pop("bad.sg").startswith("its process ended, perhaps" if isinstance(killer, Killer) else "the ")
    assert errors == dict.fromkeys(("0.sg", "1.sg", "2.sg", "last.sg"))


def test_an_executor_that_loses_a_worker() -> None:
    """The pictures that it had are recorded, and the next run takes them last: each met the one that kills at first."""
    items: list[Any] = [("a", PHOTO), ("lost", Killer()), ("b", PHOTO), ("c", PHOTO), ("d", PHOTO)]
    for made in (["a.sg"], ["a.sg", "b.sg", "c.sg", "d.sg"]):
        with (
            ProcessPoolExecutor(1, get_context("spawn")) as executor,
            pytest.raises(SgError, match=r"^the executor has broken: .*; run again with another one, and resume$"),
        ):
            encode_many(items, "out", executor=executor, jobs=1, resume=True, gaussians=9, effort=1)
        assert [row["name"] for row in rows() if row["error"] is None] == made
    assert [row["name"] for row in rows()] == ["a.sg", "lost.sg", "b.sg", "c.sg", "d.sg", "lost.sg"]
    assert rows()[1]["error"].startswith("the executor broke while it had the picture: ")


def test_a_task_that_its_executor_gives_up() -> None:
    """A cancelled one, and one whose worker ended, as Dask says it: the rest continues."""

    class KilledWorker(Exception):  # noqa: N818 - the name in Dask
        pass

    class GivesUp(Executor):
        def submit(self, function: Any, /, *arguments: Any, **_: Any) -> Future[Any]:
            future: Future[Any] = Future()
            if arguments[1].name == "0.png":
                future.cancel()
                future.set_running_or_notify_cancel()
            elif arguments[1].name == "1.png":
                future.set_exception(KilledWorker("4 attempts"))
            else:
                future.set_result(function(*arguments))
            return future

    assert counts(many(executor=GivesUp(), jobs=1)) == (1, 0, 2)
    errors = ["CancelledError()", "KilledWorker('4 attempts')"]
    assert [row["error"] for row in rows()] == [*(f"the executor gave no result: {error}" for error in errors), None]


@pytest.mark.parametrize("is_begun", [False, True])
def test_an_executor_that_loses_its_connection(is_begun: bool) -> None:
    """The error is the executor's: each picture left became a failed line, and the run went on to the next."""

    class Lost(Executor):
        def submit(self, function: Any, /, *arguments: Any, **_: Any) -> Future[Any]:
            future: Future[Any] = Future()
            if arguments[1].name == "0.png":
                future.set_result(function(*arguments))
            elif is_begun:
                future.set_exception(ConnectionError("the scheduler is gone"))
            else:
                raise ConnectionError("the scheduler is gone")
            return future

    with pytest.raises(SgError, match=r"^the executor has failed: the scheduler is gone; run again, and resume$"):
        many(executor=Lost(), jobs=1)
    assert [(row["name"], row["error"]) for row in rows()] == [("0.sg", None)]
    assert counts(many(resume=True)) == (2, 1, 0)


def test_an_executor_is_given_few_pictures_ahead_and_those_are_cancelled() -> None:
    """Their paths are absolute, as its processes may have another current folder."""
    given: list[Future[Any]] = []
    taken: list[Any] = []

    class Waits(Executor):
        def submit(self, function: Any, /, *arguments: Any, **_: Any) -> Future[Any]:
            given.append(Future())
            taken.append(arguments[1])
            if len(given) == 1:
                given[0].set_result(function(*arguments))
            return given[-1]

    names = (f"{number}.png" for number in range(3))
    with pytest.raises(KeyboardInterrupt):
        encode_many(names, "out", executor=Waits(), jobs=2, on_row=Mock(side_effect=KeyboardInterrupt))
    assert [one.cancelled() for one in given] == [False, True]
    assert taken == [Path("0.png").absolute(), Path("1.png").absolute()]


@pytest.mark.parametrize(("cut", "nuls"), [(1, 0), (-1, 0), (0, 4096), (100, 9)])
def test_a_line_that_was_cut_off(cut: int, nuls: int) -> None:
    """After a kill in the middle of a write, or a power cut, its picture is encoded again, the others are not."""
    many()
    path = Path("out/manifest.jsonl")
    before, lines = rows(), path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2]) + lines[2][:cut] + bytes(nuls))
    assert counts(many(resume=True)) == (1, 2, 0)
    for row in (before[2], after := rows()[2]):
        row["figures"].pop("seconds")
    assert [*rows()[:2], after] == before


@pytest.mark.parametrize("text", ["hello", "\n", '{"image": 1}\n', '{"name": "a"}\n', '{"name": "0.sg", "by\n'])
def test_a_file_of_another_kind_is_left_alone(text: str) -> None:
    Path("out").mkdir()
    Path("out/manifest.jsonl").write_text(text)
    with pytest.raises(SgError, match=r"^out/manifest\.jsonl is .* line 1: |\(line 1\): move it away$"):
        many()
    assert Path("out/manifest.jsonl").read_text() == text


def test_a_full_disk() -> None:
    """The run ends, since nothing would remember the rest."""
    with Manifest("", {}) as manifest, Path("/dev/full").open("ab", buffering=0) as full:
        os.dup2(full.fileno(), manifest._file.fileno())
        with pytest.raises(SgError, match=r"^cannot write manifest\.jsonl: No space left on device$"):
            manifest.add(Row("a.sg", None))


RUN = """
import sys
from sgmethod import encode_many
if __name__ == "__main__":
    encode_many(sys.argv[1:], "out", jobs=2, resume=True, effort=1, gaussians=9)
"""


def test_a_killed_run_goes_on() -> None:
    """Slow: 20 encodes, by a program that is killed after a few: no picture twice, none lost, the same bytes."""
    for number in range(3, 20):
        PHOTO.rotate(number).save(f"{number}.png")
    Path("run.py").write_text(RUN)
    process = subprocess.Popen([sys.executable, "run.py", *map(str, paths())], start_new_session=True)
    manifest = Path("out/manifest.jsonl")
    wait_until(lambda: manifest.exists() and manifest.read_bytes().count(b"\n") >= 3)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    before = manifest.read_bytes().count(b"\n")
    assert 3 <= before < 20
    tally = encode_many(map(str, paths()), "out", resume=True, effort=1, gaussians=9)
    assert counts(tally) == (20 - before, before, 0)
    names = [row["name"] for row in rows()]
    assert sorted(names) == sorted(f"{path.stem}.sg" for path in paths())
    for row in (rows()[0], rows()[-1]):
        assert (Path("out") / row["name"]).read_bytes() == encode(row["input"], effort=1, gaussians=9).data


def test_equal_budgets_are_one_to_a_run_that_resumes(tmp_path: Path) -> None:
    """Each made all files anew, though they are the same."""
    picture = [("a", np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8))]
    same = ({"quality": "web"}, {"quality": 60}, {"quality": 60.0}, {"budget": Budget("quality", 60)})
    skipped = [encode_many(picture, tmp_path, resume=True, effort=1, **budget).skipped for budget in same]
    assert skipped == [0, 1, 1, 1]
    assert encode_many(picture, tmp_path, resume=True, effort=1, quality=61).skipped == 0
