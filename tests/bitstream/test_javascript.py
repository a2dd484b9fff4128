"""The decoder in JavaScript against ours: payloads of strange Gaussians, whole and damaged, and the tables of both."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from benchmarks.harness.data import JAVASCRIPT, ROOT
from sgmethod.native import native

FILES = 2000  # of each kind
SIDES = [1, 2, 7, 16, 33, 64, 300, 4096, 65_535]
NATIVE = ROOT / "sgmethod" / "native" / "rd"
KINDS = "Count Distance LumaByEnergy LumaByClass A AByClass B BByLuma ColorSigns V VByClass R RByDirection ShapeSigns"

Header = dict[str, Any]
DECODE = """
import {{ readFileSync }} from "node:fs";
const {{ readGaussians }} = await import("{folder}/payload.js");
const {{ SgError }} = await import("{folder}/header.js");
console.log(JSON.stringify(JSON.parse(readFileSync(0)).map(([header, payload]) => {{
  try {{
    const values = readGaussians(header, new Uint8Array(Buffer.from(payload, "base64")));
    return Buffer.from(values.buffer).toString("base64");
  }} catch (error) {{
    return error instanceof SgError ? null : String(error.stack);
  }}
}})));
"""
TABLES = """
const {{ MODEL, modelsOf }} = await import("{folder}/coder.js");
const {{ NET, newModels }} = await import("{folder}/models.js");
const rows = {rows}.map((row) => [...row, 256]);
console.log(JSON.stringify([NET, String(newModels()) === String(modelsOf(rows))]));
"""


def in_node(script: str, given: str = "") -> Any:
    if shutil.which("node") is None:
        pytest.skip("Node is not installed: sudo apt install nodejs")
    command = ["node", "--input-type=module", "--no-warnings", "--eval", script]
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=True, timeout=120)
    return json.loads(done.stdout)


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
    whole = payloads(random)
    files = whole + [(header, damaged(payload, random)) for header, payload in whole]
    expected = [decoded(*file) for file in files]
    assert all(values is not None for values in expected[:FILES])
    given = json.dumps([(header, base64.b64encode(payload).decode()) for header, payload in files])
    answers = in_node(DECODE.format(folder=JAVASCRIPT.as_uri()), given)
    assert answers == [None if values is None else base64.b64encode(values).decode() for values in expected]
    accepted = sum(values is not None for values in expected[FILES:])
    assert FILES / 5 < accepted < FILES  # so that both are tried


def numbers(file: str, name: str) -> list[int]:
    found = re.search(rf" {name}\[.* = (\{{[^;]*);", (NATIVE / file).read_text())
    assert found is not None
    return [int(number) for number in re.findall(r"-?\d+", found[1])]


def test_it_has_the_tables() -> None:
    """Those that `node sgmethod/javascript/tables.mjs` has packed."""
    starts = np.reshape(numbers("start_tables.h", "kStarts"), (-1, 15)).tolist()
    rows = [starts[row] for kind in KINDS.split() for row in numbers("start_tables.h", f"kStart{kind}")]
    net, same = in_node(TABLES.format(folder=JAVASCRIPT.as_uri(), rows=rows))
    assert same
    expected = numbers("structure_net.h", "kMapBase")
    for name, inputs in (("Map", 4), ("Own", 3)):
        of = {kind: numbers("structure_net.h", f"k{name}{kind}") for kind in ("Bias", "Weights", "Out")}
        units = len(of["Out"])
        for h, out in enumerate(of["Out"]):
            weights = of["Weights"][inputs * h : inputs * (h + 1)]
            expected += [*weights, *[0] * (4 - inputs), out, *of["Bias"][h::units]]
    assert net == expected
