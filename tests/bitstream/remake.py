"""Write what depends on the kernels' tables again: python -m tests.bitstream.remake.

That is models.json, the golden files of version 2 and vectors.json: the same Gaussians, in other bytes. Build the
kernels first. It reads the old files with the new code, so it serves for other tables and not for another header.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from hashlib import sha256
from typing import Any

from sgmethod import decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.plain_decoder_v2 import Header, Integers, SizeClass
from tests.bitstream.plain_encoder_v2 import Wanted, write_payload
from tests.support.data import ROOT, golden, golden_path, with_checksum

FORMAT = ROOT / "docs" / "format"
MODELS, VECTORS = FORMAT / "models.json", FORMAT / "vectors.json"
PARTED = {"short": 1, "long": 1, "grey": 1, "far": 9}  # steps in which the vectors have their parts
KERNELS = ROOT / "sgmethod" / "native" / "rd"
STARTS = {  # names of the tables in the text
    "count": "Count",
    "distance": "Distance",
    "luma": "LumaByEnergy",
    "luma_by_group": "LumaByClass",
    "a": "A",
    "a_by_group": "AByClass",
    "b": "B",
    "b_by_luma": "BByLuma",
    "colour signs": "ColorSigns",
    "v": "V",
    "v_by_group": "VByClass",
    "r": "R",
    "r_by_direction": "RByDirection",
    "shape signs": "ShapeSigns",
}
WEIGHTS = {
    "map_base": "kMapBase",
    "map_bias": "kMapBias",
    "map_weights": "kMapWeights",
    "map_out": "kMapOut",
    "own_bias": "kOwnBias",
    "own_weights": "kOwnWeights",
    "own_out": "kOwnOut",
}


def arrays(name: str) -> dict[str, Any]:
    """The constant arrays of a header of the kernels, as nested lists."""
    code = (KERNELS / name).read_text()
    found = re.findall(r"^constexpr \w+ (\w+)\[[\d\]\[]+ = (\{.*?\});", code, re.DOTALL | re.MULTILINE)
    return {
        name: json.loads(re.sub(r",\s*\]", "]", value.replace("{", "[").replace("}", "]"))) for name, value in found
    }


def models() -> dict[str, Any]:
    """The kernels' tables as the text names them: rows of fifteen numbers, and the weights of the map."""
    starts, weights = arrays("start_tables.h"), arrays("density_net.h")
    rows = starts["kStarts"]
    found = {name: [rows[i] for i in starts[f"kStart{ours}"]] for name, ours in STARTS.items()}
    return {**found, **{name: weights[ours] for name, ours in WEIGHTS.items()}}


def written(value: Any, depth: int, indent: str = "") -> str:
    """JSON. Each value that deep has a line, as a stage of a file does: lines of their own would be thousands."""
    if not depth or not isinstance(value, dict | list) or not re.search(r"[\[{][\[{]|: [\[{]", json.dumps(value)):
        return json.dumps(value)
    deeper = f"{indent} "
    if isinstance(value, dict):
        rows = [f"{deeper}{json.dumps(key)}: {written(one, depth - 1, deeper)}" for key, one in value.items()]
    else:
        rows = [f"{deeper}{written(one, depth - 1, deeper)}" for one in value]
    begin, end = "{}" if isinstance(value, dict) else "[]"
    return "\n".join([begin, ",\n".join(rows), f"{indent}{end}"])


# What files hold


Layers = tuple[list[Integers], list[Integers]]  # of the picture and its alpha


def read(data: bytes) -> Layers:
    file = plain.read(data)
    return file.integers(), file.alpha_integers()


def file_of(data: bytes, layers: Layers) -> bytes:
    """A file like another, but with these Gaussians."""
    stream, (picture, alpha) = container.parse(data), layers
    assert isinstance(stream, StreamV2)
    remade = replace(stream, payload=payload(stream, picture))
    if stream.alpha is not None:
        remade = replace(remade, alpha=replace(stream.alpha, payload=payload(stream.alpha, alpha)))
    return container.serialise(remade)


def payload(stream: StreamV2, integers: list[Integers]) -> bytes:
    return write_payload(header_of(stream), [wanted(one) for one in integers])


def header_of(s: StreamV2) -> Header:
    return Header(s.grey, s.upright, s.is_short, s.width, s.height, s.quantum, s.background)


def wanted(one: Integers) -> Wanted:
    (column, row), (x, y), (a, b, c), (u, v, r) = one.cell, one.place, one.colour, one.shape
    return Wanted(one.of_class.k, (column, row), (a, b, c), (u, v, r), (x, y))


# The vectors


def layer(of: dict[str, Any], header: Header, data: bytes, integers: list[Integers]) -> None:
    """Write what a decoder makes of a payload."""
    rows = [[*plain.gaussian_of(header, one)[:5], *plain.gaussian_of(header, one)[5]] for one in integers]
    for view in of.get("views", []):  # in the same order
        places = {tuple(row[:8]): place for place, row in enumerate(of["gaussians"])}
        view["gaussians"] = [view["gaussians"][places[tuple(row)]] for row in rows]
    of["payload"] = data.hex()
    of["integers"] = [row_of(one) for one in integers]
    of["gaussians"] = [[*row, level_of(*row[2:5])] for row in rows]
    if "map" in of:
        of["map"] = maps_of(integers)


def row_of(one: Integers) -> list[int]:
    seen = one.part.energy, one.part.direction
    return [one.of_class.k, *one.cell, *one.colour, *one.shape, *one.parts, *one.place, *seen]


def maps_of(integers: list[Integers]) -> list[dict[str, Any]]:
    """The map before each class, and the class's blocks."""
    return [class_of(one) for one in {one.of_class.k: one.of_class for one in integers}.values()]


def class_of(one: SizeClass) -> dict[str, Any]:
    blocks = one.blocks
    sums = dict(zip("EXY", blocks.of_map.tolist(), strict=True)) if blocks.is_known else {}
    return {"class": one.k, "m": blocks.m, "M": blocks.level, **sums, "levels": blocks.levels}


def level_of(l1: float, l2: float, l3: float) -> int:
    """The level of a Gaussian."""
    xx, yy = l1 * l1, l2 * l2 + l3 * l3
    minor = 2 * (xx * l3) * l3 / (xx + yy + math.sqrt((xx - yy) * (xx - yy) + 4 * (xx * l2) * l2))
    return max(level for level in range(13) if level == 0 or 4.0**level <= minor / (1.4 * 1.4))


SMALL = StreamV2(4, 4, 0.5078125, (123,) * 3, grey=True, upright=False, payload=b"", is_short=True)
DOT = Wanted(0)


def small(integers: list[Wanted], side: int = 4, **odd: Any) -> bytes:
    """A small file of Gaussians that a decoder may refuse."""
    stream = replace(SMALL, width=side, height=side)
    return container.serialise(replace(stream, payload=write_payload(header_of(stream), integers, **odd)))


def refusals() -> dict[str, bytes]:
    """Files to refuse, by the reason."""
    good = small([DOT])
    long = small([Wanted(0, colour=(2**22, 0, 0))])
    assert long[-2] == 0
    return {
        "signature": with_checksum(b"\xd4" + good[1:]),
        "version": with_checksum(b"\xd3\xc3" + good[2:]),
        "checksum": good[:-1] + bytes([good[-1] ^ 1]),
        "nothing between signature and checksum": bytes.fromhex("d3c2bf"),
        "the header does not end": bytes.fromhex("d3c2890420da"),
        "a one bit fills the header": with_checksum(good[:5] + bytes([good[5] | 1]) + good[6:]),
        "the texture does not end": bytes.fromhex("d3c2a904203cff3b"),
        "a strength below 0": bytes.fromhex("d3c2a904203c8096"),
        "a strength above 15": bytes.fromhex("d3c2a904203cffffffff002f"),
        "a one bit fills the texture": bytes.fromhex("d3c2a904203c207e"),
        "the payload of alpha does not end": with_checksum(bytes.fromhex("d3c2c904203d01e300") + good[6:9]),
        "a state below 65536": small([DOT], is_early=True),
        "last class below -4": small([DOT, Wanted(-5)]),
        "more Gaussians than pixels": small([DOT] * 2, 1),
        "more Gaussians than pixels, but not in one class": small([DOT, Wanted(-1)], 1),
        "more Gaussians than 3 for each byte and 64 more": small([DOT], 40, promised=1200),
        "|v| above its limit": small([Wanted(0, shape=(0, 9, 0))]),
        "|r| above its limit": small([Wanted(0, shape=(0, 0, 2049))]),
        "no colour": small([Wanted(0, colour=(0, 0, 0))]),
        "a colour above its limit": small([Wanted(0, colour=(2**22 + 1, 0, 0))]),
        "a column before the grid": small([Wanted(0, (-1, 2))]),
        "a column behind the grid": small([Wanted(0, (8, 2))]),
        "a row behind the grid": small([Wanted(0, (2, 8))]),
        "a part that the class does not have": small([Wanted(0, (2, 34))]),
        "more bytes read than there are, all zero": with_checksum(long[:-2] + bytes(1)),
        "last state": small([DOT], last_state=65537),
        "a one bit in the queue": small([Wanted(0, colour=(4, 0, 0))], stray=1),
        "a byte that is not read": with_checksum(good[:-1] + bytes([1, 0])),
    }


def parts(data: bytes, step: int = 1) -> dict[str, Any]:
    """How many Gaussians parts of a payload hold, and the whole."""
    file = plain.read(data)
    whole = len(file.payload)
    return {"bytes": data.hex(), "parts": [[k, count(file, k)] for k in [*range(0, whole, step), whole]]}


def count(file: plain.File, k: int) -> int | None:
    try:
        return len(file.part(k))
    except plain.RefusedError:
        return None


# All


def main() -> None:
    """Read with the tables so far, and write with those of the kernels."""
    golden_files, vectors = golden(2), json.loads(VECTORS.read_text())
    layers = {name: read(data) for name, data in golden_files.items()}
    of_vectors = [read(bytes.fromhex(of["bytes"])) for of in vectors["files"]]
    MODELS.write_text(written(models(), 1) + "\n")
    plain.tables.cache_clear()
    hashes = {}
    for name, data in golden_files.items():
        remade = file_of(data, layers[name])
        golden_path(f"{name}.sg").write_bytes(remade)
        hashes[name] = {
            key: sha256(value).hexdigest() for key, value in (("bytes", remade), ("pixels", decode(remade)))
        }
    golden_path("v2-hashes.json").write_text(json.dumps(hashes, indent=2) + "\n")
    for of, found in zip(vectors["files"], of_vectors, strict=True):
        data = file_of(bytes.fromhex(of["bytes"]), found)
        of["bytes"], file = data.hex(), plain.read(data)
        layer(of, file.header, file.payload, file.integers())
        if file.alpha is not None:
            layer(of["alpha"], *file.alpha, file.alpha_integers())
    of_name = {of["name"]: bytes.fromhex(of["bytes"]) for of in vectors["files"]}
    refused = small([Wanted(0, shape=(0, 9, 0))])
    equal = small([DOT] * 1200, 40)
    stepped = [parts(of_name[name], step) for name, step in PARTED.items()]
    vectors["parts"] = [*stepped, parts(equal, 99), parts(refused)]
    vectors["refuse"] = [{"reason": reason, "bytes": data.hex()} for reason, data in refusals().items()]
    VECTORS.write_text(written(vectors, 3) + "\n")


if __name__ == "__main__":
    main()
