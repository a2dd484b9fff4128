"""fit_many() and the data sets that it makes: what is in a shard, what resumes, what collates."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import DataLoader

import sgmethod
from sgmethod.errors import BudgetError, GaussiansError, SgError
from sgmethod.torch import SgDataset, fit, fit_many, render
from sgmethod.torch.shards import samples_of
from tests.support.pictures import photo

PHOTO = photo()


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def crop(number: int) -> np.ndarray:
    """One of five pictures, of 24 x 16 pixels; the last is of 30 x 16."""
    return PHOTO[9 * number :][:16, 20 * number :][:, : 30 if number == 4 else 24]


class Labelled:
    """Five pictures with their numbers; what was asked for is noted."""

    def __init__(self, length: int = 5) -> None:
        self.length, self.asked = length, list[int]()

    def __len__(self) -> int:
        return self.length

    def __getitem__(self, index: int) -> Any:
        self.asked.append(index)
        return torch.from_numpy(crop(index)).permute(2, 0, 1), index


def many(dataset: Any = None, **more: Any) -> tuple[int, int, int]:
    tally = fit_many(dataset or Labelled(), "out", 12, **{"shard": 2, "steps": 5} | more)
    return tally.encoded, tally.skipped, tally.failed


def rows() -> list[dict[str, Any]]:
    return [json.loads(line) for line in Path("out/manifest.jsonl").read_text().splitlines()]


def shards() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(Path("out").glob("*.tar"))}


def test_shards_hold_what_fit_finds() -> None:
    seen: list[tuple[str, int]] = []
    assert many(on_row=lambda row, tally: seen.append((row.name, tally.encoded))) == (3, 0, 0)
    assert seen == [("000000.tar", 1), ("000001.tar", 2), ("000002.tar", 3)]
    assert [row["figures"]["pictures"] for row in rows()] == [2, 2, 1]
    with tarfile.open("out/000001.tar") as archive:
        assert archive.getnames() == ["000000002.npz", "000000002.cls", "000000003.npz", "000000003.cls"]
        read = {name: archive.extractfile(name).read() for name in archive.getnames()}
    assert read["000000003.cls"] == b"3"
    Path("one.npz").write_bytes(read["000000003.npz"])
    wanted = fit(torch.from_numpy(crop(3)).permute(2, 0, 1)[None], 12, steps=5)
    found, more = sgmethod.read_npz("one.npz"), np.load("one.npz")
    for values, other in zip(found.arrays, wanted, strict=False):
        assert np.array_equal(values, other[0].numpy())
    assert np.array_equal(more["background"], wanted.background[0].numpy())
    assert (more["size"].tolist(), more["error"]) == ([24, 16], wanted.error[0].numpy())


def test_items_collate_with_masks() -> None:
    many()
    data = SgDataset("out", max_gaussians=20)
    assert len(data) == 5
    (batch,) = DataLoader(data, batch_size=5)
    assert batch["cls"].tolist() == [0, 1, 2, 3, 4]
    assert batch["mask"].sum(1).tolist() == [12] * 5
    assert batch["size"].tolist() == [[24, 16]] * 4 + [[30, 16]]
    image = render(batch["means"], batch["factors"], batch["colors"], (24, 16), batch["background"])[2]
    assert (255 * image - torch.from_numpy(crop(2)).permute(2, 0, 1)).square().mean() < 30**2
    largest = SgDataset("out/000001.tar", max_gaussians=3)
    assert len(largest) == 2
    assert torch.equal(largest[1]["means"], batch["means"][3, :3])
    assert largest[1]["mask"].all()


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:This DataLoader will create 2 worker processes")  # on a machine of one core
def test_several_processes_read() -> None:
    many()
    loader = DataLoader(SgDataset("out", max_gaussians=12), num_workers=2, multiprocessing_context="spawn")
    assert [batch["cls"].item() for batch in loader] == [0, 1, 2, 3, 4]


def test_pictures_and_labels_of_any_kind() -> None:
    Image.fromarray(crop(1)).save("one.png")
    items = [(crop(0), {"text": "a wall"}), "one.png", (Image.fromarray(crop(2)), torch.tensor(7))]
    assert many(items) == (2, 0, 0)
    data = SgDataset("out", max_gaussians=12)
    assert [data[index].get("json") for index in range(3)] == [{"text": "a wall"}, None, None]
    assert [data[index].get("cls") for index in range(3)] == [None, None, 7]


def test_what_is_done_is_skipped() -> None:
    many()
    first, data = shards(), Labelled()
    assert many(data, resume=True) == (0, 3, 0)
    assert data.asked == []
    Path("out/000001.tar").write_bytes(b"cut off")
    assert many(data, resume=True) == (1, 2, 0)
    assert data.asked == [2, 3]
    assert shards() == first
    assert many(resume=True, steps=3) == (3, 0, 0)
    assert many(Labelled(4), resume=True, steps=3) == (2, 0, 0)  # another data set


def test_a_shard_that_fails_is_tried_again() -> None:
    items = [crop(0), crop(1), "none.png", crop(3)]
    assert many(items) == (1, 0, 1)
    assert "none.png" in rows()[1]["error"]
    assert len(SgDataset("out", max_gaussians=1)) == 3
    Image.fromarray(crop(2)).save("none.png")
    assert many(items, resume=True) == (1, 1, 0)
    assert len(SgDataset("out", max_gaussians=1)) == 4


def test_one_picture_is_left_out_of_its_shard() -> None:
    """The others are in it, under their own numbers."""
    items = [(PHOTO[:3, :3], 0), (crop(1), 1), (crop(2), "a wall"), (crop(3), 3)]
    assert many(items, shard=4) == (0, 0, 1)
    row = rows()[-1]
    assert row["error"] == "2 of 4 pictures cannot be fitted; picture 0: 3 x 3 pixels are too few for 12 Gaussians"
    assert row["notes"][1] == "picture 2: a label must be a whole number or a dict for JSON, not 'a wall'"
    assert row["figures"]["pictures"] == 2
    with tarfile.open("out/000000.tar") as archive:
        assert archive.getnames() == ["000000001.npz", "000000001.cls", "000000003.npz", "000000003.cls"]
    data = SgDataset("out", max_gaussians=12)
    assert [data[index]["cls"] for index in range(len(data))] == [1, 3]


def test_a_shard_of_pictures_that_all_fail() -> None:
    assert many([PHOTO[:3, :3]]) == (0, 0, 1)
    assert shards() == {}


@pytest.mark.parametrize("folder", ["./", "train/", "v1.0/", "/a/b.c/"])
def test_a_shard_that_was_packed_again(folder: str) -> None:
    """By tar, from a folder of files, among which a Mac puts its own."""
    many(Labelled(2))
    with tarfile.open("out/000000.tar") as archive:
        files = [(entry.name, archive.extractfile(entry).read()) for entry in archive]  # type: ignore[union-attr]
    with tarfile.open("again.tar", "w") as archive:
        whole = tarfile.TarInfo(folder)
        whole.type = tarfile.DIRTYPE
        archive.addfile(whole)
        for name, data in files:
            for start, content in (("._", b"Mac OS X"), ("", data)):
                entry = tarfile.TarInfo(folder + start + name)
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))
    data, again = (SgDataset(f"{path}.tar", max_gaussians=12) for path in ("out/000000", "again"))
    assert [again[index]["cls"] for index in range(len(again))] == [0, 1]
    assert torch.equal(again[1]["means"], data[1]["means"])


def test_other_files_are_no_shards() -> None:
    Path("text.tar").write_text("hello")
    Path("empty").mkdir()
    with tarfile.open("other.tar", "w") as archive:
        for end in ("npz", "json"):
            entry = tarfile.TarInfo(f"a.{end}")
            entry.size = 5
            archive.addfile(entry, io.BytesIO(b"hello"))
    with pytest.raises(GaussiansError, match="has no Gaussians of fit_many"):
        SgDataset("other.tar", max_gaussians=5)[0]
    with pytest.raises(SgError, match="has a label that is not JSON"):
        samples_of("other.tar")[0].label()


def test_a_shard_with_a_size_that_is_none(tmp_path: Path) -> None:
    """tarfile raises errors of its arithmetic for some."""
    header = bytearray(tarfile.TarInfo("a.npz").tobuf(tarfile.USTAR_FORMAT))
    header[124:136] = b"\x80" + (2**70).to_bytes(11, "big")
    header[148:156] = b"%06o\0 " % (sum(header[:148]) + sum(header[156:]) + 8 * 32)
    (tmp_path / "a.tar").write_bytes(bytes(header) + bytes(10240 - 512))
    with pytest.raises(SgError, match="is not a shard"):
        samples_of(tmp_path / "a.tar")


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: SgDataset(__file__, max_gaussians=5), SgError, "is not a shard"),
        (lambda: SgDataset(".", max_gaussians=5), SgError, "has no fitted pictures"),
        (lambda: SgDataset("none.tar", max_gaussians=5), FileNotFoundError, "none.tar"),
        (lambda: SgDataset(".", size=(8, 8)), SgError, "a list of files, not one file"),
        (lambda: many(shard=0), SgError, "pictures in a shard must be a whole number from 1"),
        (lambda: many(steps=0), BudgetError, "steps must be a whole number from 1"),
        (lambda: many(device="cuda:99"), SgError, "no device 'cuda:99' here"),
    ],
)
def test_wrong_arguments(call: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        call()
