"""Pictures as people make them on a screen: a chart, a page of text, windows. OpenCV draws the letters."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]

INK, WHITE = (0, 0, 0), (255, 255, 255)
WORDS = (
    "A Gaussian is a coloured blob with a centre, a shape and a signed colour. The picture is the plain sum of all of "
    "them on a background. None hides another, so that no order is needed. Thin strokes, sharp corners and letters of "
    "a few pixels ask for many, each of them narrow; a photograph asks for fewer and wider ones. 0123456789 (+-*/=) "
)


def _write(pixels: Pixels, words: str, at: tuple[int, int], scale: float = 0.3, colour: Colour = INK) -> None:
    """Put words with the left end of their base line at (x, y)."""
    cv2.putText(pixels, words, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)


def _box(pixels: Pixels, corner: tuple[int, int], size: tuple[int, int], colour: Colour) -> None:
    """A filled rectangle; corner and size are (x, y)."""
    (x, y), (width, height) = corner, size
    pixels[y : y + height, x : x + width] = colour


def chart(side: int) -> Pixels:
    """A line chart on white: axes, ticks with numbers, two curves, a title."""
    pixels = np.full((side, side, 3), 255, np.uint8)
    left, top, right, bottom = 32, 28, side - 12, side - 28
    _write(pixels, "PSNR against rate", (72, 16), 0.4)
    cv2.line(pixels, (left, top), (left, bottom), INK)
    cv2.line(pixels, (left, bottom), (right, bottom), INK)
    for tick in range(6):
        x, y = left + tick * (right - left) // 6, bottom - tick * (bottom - top) // 6
        cv2.line(pixels, (x, bottom), (x, bottom + 4), INK)
        cv2.line(pixels, (left - 4, y), (left, y), INK)
        _write(pixels, f"{tick / 5:.1f}", (x - 8, bottom + 15))
        _write(pixels, f"{20 + 4 * tick}", (8, y + 3))
    at = np.linspace(0, 1, 64)
    for curve, colour in ((np.sqrt(at), (200, 30, 30)), (at**2 * (1 + 0.1 * np.sin(40 * at)), (20, 70, 200))):
        points = np.stack([left + at * (right - left), bottom - 0.85 * curve * (bottom - top)], axis=1)
        cv2.polylines(pixels, [np.round(points).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
    return pixels


def text(side: int) -> Pixels:
    """A page of small text, black on white."""
    pixels = np.full((side, side, 3), 255, np.uint8)
    letters = side // 4  # the longest such line is as wide as the page
    for line, y in enumerate(range(14, side - 4, 12)):
        start = line * letters % len(WORDS)
        _write(pixels, (WORDS + WORDS)[start : start + letters], (6, y))
    return pixels


def screenshot(side: int) -> Pixels:
    """Two windows with title bars, text and buttons over a grid of icons on a flat desktop."""
    pixels = np.full((side, side, 3), (40, 90, 130), np.uint8)
    random = np.random.default_rng(0)
    for y in range(10, side - 20, 32):
        for x in range(10, side - 20, 32):
            red, green, blue = random.integers(0, 256, 3)
            _box(pixels, (x, y), (18, 18), (red, green, blue))
            _box(pixels, (x + 5, y + 5), (8, 8), WHITE)
    for (x, y), title in (((24, 20), "Settings"), ((96, 110), "Editor")):
        _box(pixels, (x, y), (140, 120), (90, 90, 90))
        _box(pixels, (x + 1, y + 1), (138, 118), (240, 240, 240))
        _box(pixels, (x + 1, y + 1), (138, 15), (0, 84, 166))
        _write(pixels, title, (x + 6, y + 12), 0.35, WHITE)
        _write(pixels, "x", (x + 127, y + 11), 0.35, WHITE)
        for line in range(4):
            _write(pixels, WORDS[line * 22 : line * 22 + 22], (x + 6, y + 30 + 13 * line))
        for number, word in enumerate(("OK", "Cancel")):
            _box(pixels, (x + 20 + 60 * number, y + 94), (48, 16), (120, 120, 120))
            _box(pixels, (x + 21 + 60 * number, y + 95), (46, 14), (225, 225, 225))
            _write(pixels, word, (x + 28 + 60 * number, y + 105))
    _box(pixels, (0, side - 12), (side, 12), (30, 30, 30))
    return pixels
