"""sg_decode, the decoder that is the core alone, and the questions that it is asked."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import sgmethod
from sgmethod.view import View
from tests.harness.data import damaged
from tests.native.harness.golden import GOLDEN, is_golden

VIEWS = (
    View(),
    View(0.5),
    View(0.37, prefix=0.5),
    View(1.75),
    View(prefix=0.25),
    View(2, (1, 0, 3, 2), 0.75),
    View(1, (3, 2, 1, 1)),
)
Answer = NDArray[np.uint8] | None  # pixels [H, W, 4], of Python [H, W, 3 or 4], or None for what is refused


def ask(command: Sequence[str], questions: Sequence[tuple[Path, View]]) -> list[Answer]:
    """What a decoder answers. Raises CalledProcessError if it fails, ValueError for an answer that is none."""
    lines = []
    for path, view in questions:
        x, y, width, height = view.region or (0, 0, 0, 0)
        lines.append(f"{view.scale!r} {view.prefix!r} {x} {y} {width} {height} {path}\n")
    done = subprocess.run([*command], input="".join(lines).encode(), capture_output=True, check=True)
    answers: list[Answer] = []
    rest = done.stdout
    for _ in questions:
        line, _, rest = rest.partition(b"\n")
        if line.startswith(b"refused "):
            answers.append(None)
            continue
        width, height = map(int, line.split())
        answers.append(np.frombuffer(rest[: 4 * width * height], np.uint8).reshape(height, width, 4))
        rest = rest[4 * width * height :]
    if rest:
        raise ValueError(f"{len(rest)} bytes too many")
    return answers


def decoded(path: Path, view: View) -> Answer:
    """What Python answers."""
    try:
        return sgmethod.decode(path, view=view)
    except sgmethod.SgError:
        return None


def golden_questions(folder: Path) -> list[tuple[Path, View]]:
    """Every golden file and view. folder: room for the files."""
    questions = []
    for name, data in GOLDEN.items():
        path = folder / f"{name}.sg"
        path.write_bytes(data)
        questions += [(path, view) for view in VIEWS]
    return questions


def damaged_questions(folder: Path, count: int) -> list[tuple[Path, View]]:
    """Damaged files whose checksums fit. Whole: what stands behind the end of a prefix some decoders look at."""
    random, names = np.random.default_rng(1), sorted(GOLDEN)
    questions = []
    for k in range(count):
        value, growth = random.bytes(1 + k % 3), int(random.integers(-4, 3))
        data = damaged(GOLDEN[names[k % len(names)]], random.random(), value, growth)
        path = folder / f"damaged-{k}.sg"
        path.write_bytes(data)
        questions.append((path, View()))
    return questions


def differing(command: Sequence[str], questions: Sequence[tuple[Path, View]]) -> list[str]:
    """The questions to which a decoder's answers are not Python's, or are not what a golden file decodes to."""
    wrong = []
    for (path, view), answer in zip(questions, ask(command, questions), strict=True):
        expected = decoded(path, view)
        same = answer is None and expected is None
        if answer is not None and expected is not None:
            if expected.shape[2] == 3 and (answer[..., 3] == 255).all():
                answer = answer[..., :3]
            same = np.array_equal(answer, expected)
        golden = path.stem in GOLDEN and view == View()
        if not same or (golden and not (answer is not None and is_golden(path.stem, np.ascontiguousarray(answer)))):
            wrong.append(f"{path.name} {view}")
    return wrong
