"""Names of a run's files."""

from __future__ import annotations

import json
from pathlib import Path
from unicodedata import normalize

import pytest
from PIL import Image

from sgmethod import SgError, encode_many
from sgmethod.cli.main import main
from sgmethod.many.names import Names

COMPOSED, DECOMPOSED = normalize("NFC", "é"), normalize("NFD", "é")


def taken(folder: Path, *sources: str) -> list[str]:
    names = Names(folder)
    return [names.take(source, f"{Path(source).stem}.sg", f"{Path(source).name}.sg") for source in sources]


@pytest.mark.parametrize(
    ("sources", "names"),
    [
        (["IMG_1.JPG", "img_1.png", "a/IMG_2.JPG"], ["IMG_1.sg", "img_1.png.sg", "IMG_2.sg"]),
        (["a.jpg", "A.jpg"], ["a.sg", "A.jpg.sg"]),
        (["straße.jpg", "STRASSE.JPG"], ["straße.sg", "STRASSE.JPG.sg"]),
        ([f"{COMPOSED}.jpg", f"{DECOMPOSED}.png"], [f"{COMPOSED}.sg", f"{DECOMPOSED}.png.sg"]),
        ([f"{COMPOSED}.jpg", f"E{DECOMPOSED[1:]}.png"], [f"{COMPOSED}.sg", f"E{DECOMPOSED[1:]}.png.sg"]),
        (["\udcff.jpg", "\udcff.png"], ["\udcff.sg", "\udcff.png.sg"]),  # a byte that is no text
    ],
)
def test_names_differ_on_every_file_system(sources: list[str], names: list[str], tmp_path: Path) -> None:
    assert taken(tmp_path, *sources) == names


def test_equal_names_are_refused(tmp_path: Path) -> None:
    names = Names(tmp_path)
    assert [names.take("one", "a.sg"), names.take("two", "A.sg")] == ["a.sg", "A.sg"]
    with pytest.raises(SgError, match=r"^two and three would both become .*A\.sg$"):
        names.take("three", "A.sg")
    twice = [("a", Image.new("RGB", (8, 8)))] * 2
    with pytest.raises(SgError, match=r"'a' and the picture 'a' would both become .*a\.sg: give other names"):
        encode_many(twice, tmp_path, effort=1)


@pytest.mark.parametrize("line", ["encode --no-clobber", "encode --resume", "encode", "preview --resume", "library"])
def test_a_name_stays_with_its_picture(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture that is added later takes no file of another, although its name comes first."""
    monkeypatch.chdir(tmp_path)
    Path("photos").mkdir()

    def run() -> dict[str, str]:
        if line == "library":
            encode_many(sorted(Path("photos").iterdir()), "out", resume=True, effort=1)
        else:
            effort = ["--effort", "1"] if "encode" in line else []
            assert main([*line.split(), "photos", "--output-dir", "out", "--quiet", *effort]) == 0
        rows = map(json.loads, Path("out/manifest.jsonl").read_text().splitlines())
        return {row["name"]: Path(row["input"]).name for row in rows}

    Image.new("RGB", (8, 8), "red").save("photos/b.png")
    assert run() == {"b.sg": "b.png"}
    first = Path("out/b.sg").read_bytes()
    for added, name in (("a.jpg", "a.sg"), ("b.jpg", "b.jpg.sg"), ("B.gif", "B.gif.sg")):
        Image.new("RGB", (8, 8), "blue").save(f"photos/{added}")
        assert run()[name] == added
    assert run() == {"a.sg": "a.jpg", "b.sg": "b.png", "b.jpg.sg": "b.jpg", "B.gif.sg": "B.gif"}
    assert {path.name for path in Path("out").glob("*.sg")} == {"a.sg", "b.sg", "b.jpg.sg", "B.gif.sg"}
    assert Path("out/b.sg").read_bytes() == first


def test_a_run_resumes_with_the_same_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("photos").mkdir()
    Image.new("RGB", (8, 8), "red").save("photos/img.png")
    Image.new("RGB", (8, 8), "blue").save("photos/IMG.JPG")
    for line in ("encode photos --effort 1 --quiet --resume", "preview photos --quiet --resume"):
        verb = line.split()[0]
        for _ in range(2):
            assert main([*line.split(), "--output-dir", verb]) == 0
            assert {path.name for path in Path(verb).glob("*.sg")} == {"IMG.sg", "img.png.sg"}
        assert len(Path(verb, "manifest.jsonl").read_text().splitlines()) == 2
    assert main(["decode", "encode", "--output-dir", "decode", "--quiet"]) == 0
    assert {path.name for path in Path("decode").iterdir()} == {"IMG.png", "img.png.png"}
