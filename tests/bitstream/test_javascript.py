"""The decoder in JavaScript against ours: payloads of strange Gaussians, whole and damaged, and the tables of both."""

from __future__ import annotations

import base64
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import sgmethod
from sgmethod import BitstreamError
from sgmethod.bitstream import container
from sgmethod.native import native
from tests.support import javascript_settings
from tests.support.data import JAVASCRIPT, ROOT, damaged as tampered, golden
from tests.support.node import answer_of, node

FILES = 2000  # of each kind
SIDES = [1, 2, 7, 16, 33, 64, 300, 4096, 65_535]
NATIVE = ROOT / "sgmethod" / "native" / "rd"

Header = dict[str, Any]
DECODE = """
const { readGaussians } = await import(`${src}/payload.js`);
const { SgError } = await import(`${src}/header.js`);
console.log(JSON.stringify(given.map(([header, payload]) => {
  try {
    const values = readGaussians(header, new Uint8Array(Buffer.from(payload, "base64")));
    return Buffer.from(values.buffer).toString("base64");
  } catch (error) {
    return error instanceof SgError ? null : String(error.stack);
  }
})));
"""


def parameters(header: Header) -> Any:
    return native.RdParameters(*(header[name] for name in ("width", "height", "quantum", "grey", "upright", "isShort")))


def payloads(random: np.random.Generator) -> list[tuple[Header, bytes]]:
    """What decoding noise gives, encoded."""
    found: list[tuple[Header, bytes]] = []
    while len(found) < FILES:
        width, height = (int(side) for side in random.choice(SIDES, 2))
        grey, upright, is_short = (bool(flag) for flag in random.integers(0, 2, 3))
        quantum = float(random.choice([2.0**-10, 0.01, 0.1, 1.0, 15.0]))
        flags = {"grey": grey, "upright": upright, "isShort": is_short}
        header = {"width": width, "height": height, "quantum": quantum, **flags}
        noise = bytearray(random.bytes(int(random.choice([40, 150, 600, 2000]))))
        classes = random.integers(0, 29), random.integers(0, 12)  # the first, from the largest on, and how many more
        noise[4 if is_short else 8] = int(classes[0] | classes[1] % 4 << 6)
        try:
            gaussians = native.rd_decode(parameters(header), bytes(noise), True)
        except RuntimeError:
            continue
        if len(gaussians[0]):
            found.append((header, native.rd_encode(parameters(header), *gaussians)))
    return found


def far_and_fine(random: np.random.Generator) -> list[tuple[Header, bytes]]:
    """A few small, strong Gaussians in the largest picture: each place needs up to 28 bits along x and y."""
    found = []
    for number in range(100):
        flags = {"grey": bool(number & 1), "upright": False, "isShort": bool(number & 2)}
        header = {"width": 65_535, "height": 65_535, "quantum": 2.0**-10, **flags}
        n = int(random.integers(1, 4))
        size = np.exp(random.uniform(-1, 0.5, n))
        values = random.uniform(0, 65_535, (n, 2)), np.stack([size, 0 * size, size], 1), random.uniform(1, 3000, (n, 3))
        gaussians = [array.astype(np.float32) for array in values]
        found.append((header, native.rd_encode(parameters(header), *gaussians)))
    return found


def decoded(header: Header, payload: bytes) -> bytes | None:
    try:
        return np.concatenate(native.rd_decode(parameters(header), payload), axis=1).astype(np.float32).tobytes()
    except RuntimeError:
        return None


def damaged(payload: bytes, random: np.random.Generator) -> bytes:
    """Another byte or more, most often near the end, where what follows may still be right."""
    changed = bytearray(payload)
    for _ in range(int(random.integers(1, 3)) if payload else 0):
        changed[-1 - int(len(payload) * random.uniform() ** 3)] ^= 1 << int(random.integers(0, 8))
    return bytes(changed[: len(changed) - int(random.choice([0, 0, 0, 1, 5]))])


def test_it_decodes_and_refuses_the_same() -> None:
    random = np.random.default_rng(1)
    whole = [*payloads(random), *far_and_fine(random)]
    files = whole + [(header, damaged(payload, random)) for header, payload in whole]
    expected = [decoded(*file) for file in files]
    assert all(values is not None for values in expected[: len(whole)])
    answers = answer_of(DECODE, [(header, base64.b64encode(payload).decode()) for header, payload in files])
    assert answers == [None if values is None else base64.b64encode(values).decode() for values in expected]
    accepted = sum(values is not None for values in expected[len(whole) :])
    assert FILES / 5 < accepted < FILES  # so that both are tried


PART = """
const { decode } = await import(`${src}/decoder.js`);
console.log(JSON.stringify(given.map((file) => {
  try {
    return decode(new Uint8Array(Buffer.from(file, "base64")), { prefix: 0.5 }).data.length;
  } catch (error) {
    return error.name;
  }
})));
"""


def test_a_damaged_tail_is_refused_whatever_part_is_drawn() -> None:
    whole = golden(2)["v2-color"]
    changed = [tampered(whole, place, bytes([value]), 0) for place in (0.9, 0.95, 0.99) for value in range(0, 256, 9)]
    files = [file for file in changed if refused(container.parse(file).scene)]
    assert len(files) > 20
    for file in files:
        assert len(container.parse(file).scene(0.5).gaussians) > 0  # the first half is as it was
        assert refused(partial(sgmethod.decode, file, view=sgmethod.View(prefix=0.5)))
    encoded = [base64.b64encode(file).decode() for file in (whole, *files)]
    size, *names = answer_of(PART, encoded)
    assert size > 0
    assert names == ["SgError"] * len(files)


def refused(call: Callable[[], object]) -> bool:
    try:
        call()
    except BitstreamError:
        return True
    return False


def test_it_has_the_tables(tmp_path: Path) -> None:
    """Those that `node sgmethod/javascript/tables.mjs` packs."""
    shutil.copytree(JAVASCRIPT.parent, tmp_path / "javascript")
    shutil.copytree(NATIVE, tmp_path / "native" / "rd")
    tables = tmp_path / "javascript" / "src" / "tables.js"
    tables.unlink()
    node(f'await import("{(tmp_path / "javascript" / "tables.mjs").as_uri()}")')
    assert tables.read_text() == (JAVASCRIPT / "tables.js").read_text()


def test_its_encoder_has_the_settings() -> None:
    """Those that `python -m tests.support.javascript_settings` writes."""
    assert javascript_settings.WRITTEN.read_text() == javascript_settings.text()
