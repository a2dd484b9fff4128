"""Pictures that are hard for smooth blobs of colour: thin, sharp, busy, tiny or long. All are drawn, none is read.

Each is an array [H, W, 3] of 8-bit RGB, the same at every call; SIDE x SIDE pixels unless its name says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.pictures import Pixels

Float = NDArray[np.float64]
Colour = tuple[int, int, int]

SIDE = 256
LONG = 300  # of the pictures that are one pixel wide or high
LINES_APART = 32
BLACK, WHITE = (0, 0, 0), (255, 255, 255)
RED, BLUE = (255, 0, 0), (0, 0, 255)
PRIMARIES = (RED, (0, 255, 0), BLUE, (0, 255, 255), (255, 0, 255), (255, 255, 0))
WORDS = (
    "A Gaussian is a coloured blob with a centre, a shape and a signed colour. The picture is the plain sum of all of "
    "them on a background. None hides another, so that no order is needed. Thin strokes, sharp corners and letters of "
    "a few pixels ask for many, each of them narrow; a photograph asks for fewer and wider ones. 0123456789 (+-*/=) "
)


def grid(height: int = SIDE, width: int = SIDE) -> tuple[Float, Float]:
    """y and x of every pixel, each [H, W]."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    return y, x


def grey(levels: Float) -> Pixels:
    """Levels [H, W] in 0 to 255, rounded, in all three channels."""
    return np.repeat(np.round(levels).astype(np.uint8)[..., None], 3, axis=2)


def lines(degrees: float, *, white: bool) -> Pixels:
    """Parallel lines one pixel wide; how far a pixel is from the next one gives its level."""
    y, x = grid()
    angle = np.radians(degrees)
    across = (y - SIDE / 2) * np.cos(angle) + (x - SIDE / 2) * np.sin(angle)
    away = np.abs(across - LINES_APART * np.round(across / LINES_APART))
    light = np.round(255 * np.clip(1 - away, 0, 1))
    return grey(light if white else 255 - light)


def checkerboard(cell: int) -> Pixels:
    """Black and white squares with sides of that many pixels."""
    y, x = grid()
    return grey(255 * ((x // cell + y // cell) % 2))


def zone_plate() -> Pixels:
    """Rings that become finer outwards: half a cycle for each pixel in the middle of each side."""
    y, x = grid()
    square = (x - SIDE / 2) ** 2 + (y - SIDE / 2) ** 2
    return grey(127.5 + 127.5 * np.cos(np.pi * square / SIDE))


def impulses() -> Pixels:
    """Single bright pixels on black, every second one coloured."""
    random = np.random.default_rng(0)
    pixels = np.zeros((SIDE, SIDE, 3), np.uint8)
    for number, place in enumerate(random.choice(SIDE * SIDE, 48, replace=False)):
        pixels[divmod(int(place), SIDE)] = WHITE if number % 2 else PRIMARIES[number // 2 % len(PRIMARIES)]
    return pixels


def steps_and_ramps() -> Pixels:
    """Four bands: 16 steps, a ramp to the right, a ramp down, one hard edge."""
    y, x = grid()
    band = SIDE // 4
    levels = (x // 16 * 17, x, (y - 2 * band) / (band - 1) * 255, 255 * (x >= SIDE / 2))
    return grey(np.select([y < band, y < 2 * band, y < 3 * band], levels[:3], levels[3]))


def noise() -> Pixels:
    """Every level of every channel as likely as any other."""
    return np.random.default_rng(0).integers(0, 256, (SIDE, SIDE, 3), np.uint8)


def row() -> Pixels:
    """One row [1, LONG, 3]: a wave that grows faster, a step, a single pixel, each channel a little later."""
    x = np.arange(LONG, dtype=np.float64)
    channels = []
    for delay in (0, 5, 10):
        wave = 100 + 60 * np.sin((x - delay) ** 2 / 900)
        wave[x >= 200 + delay] = 220
        wave[250 + delay] = 0
        channels.append(np.round(wave))
    return np.stack(channels, axis=1)[None].astype(np.uint8)


def column() -> Pixels:
    """The row, turned: [LONG, 1, 3]."""
    return np.ascontiguousarray(row().transpose(1, 0, 2))


def pixel() -> Pixels:
    """A single one."""
    return np.array([[(200, 120, 40)]], np.uint8)


def strip() -> Pixels:
    """A long ramp, 4096 x 16, with a dark line across it every 256 pixels."""
    _, x = grid(16, 4096)
    return grey(np.where(x % 256 == 128, 0, 32 + x / 4095 * 223))


def structured_grey() -> Pixels:
    """A disc with a hard edge and a soft blob on stripes that become finer, without any colour."""
    y, x = grid()
    levels = 120 + 40 * np.sin(x**2 / 400)
    levels[np.hypot(x - 80, y - 90) < 50] = 230
    levels -= 100 * np.exp(-((x - 180) ** 2 + (y - 170) ** 2) / 1800)
    return grey(levels.clip(0, 255))


def primaries() -> Pixels:
    """Patches of 32 pixels in red, green, blue, cyan, magenta and yellow; each row begins one colour later."""
    y, x = grid()
    which = (x // 32 + y // 32).astype(int) % len(PRIMARIES)
    return np.take(np.array(PRIMARIES, np.uint8), which, axis=0)


def columns(left: tuple[int, int, int], right: tuple[int, int, int]) -> Pixels:
    """Two colours in turns, each column one pixel wide."""
    return np.tile(np.array([left, right], np.uint8), (SIDE, SIDE // 2, 1))


def _write(pixels: Pixels, words: str, at: tuple[int, int], scale: float = 0.3, colour: Colour = BLACK) -> None:
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
    cv2.line(pixels, (left, top), (left, bottom), BLACK)
    cv2.line(pixels, (left, bottom), (right, bottom), BLACK)
    for tick in range(6):
        x, y = left + tick * (right - left) // 6, bottom - tick * (bottom - top) // 6
        cv2.line(pixels, (x, bottom), (x, bottom + 4), BLACK)
        cv2.line(pixels, (left - 4, y), (left, y), BLACK)
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


ANGLES = (0, 10, 30, 45)
PICTURES: dict[str, Callable[[], Pixels]] = {
    **{f"lines-{angle}-on-white": partial(lines, angle, white=False) for angle in ANGLES},
    **{f"lines-{angle}-on-black": partial(lines, angle, white=True) for angle in ANGLES},
    "chart": partial(chart, SIDE),
    "text": partial(text, SIDE),
    **{f"checkerboard-{cell}": partial(checkerboard, cell) for cell in (1, 2, 3)},
    "zone-plate": zone_plate,
    "impulses": impulses,
    "steps-and-ramps": steps_and_ramps,
    "noise": noise,
    "screenshot": partial(screenshot, SIDE),
    f"row-{LONG}x1": row,
    f"column-1x{LONG}": column,
    "pixel-1x1": pixel,
    "strip-4096x16": strip,
    "grey": structured_grey,
    "primaries": primaries,
    "columns-red-blue": partial(columns, RED, BLUE),
    "columns-black-white": partial(columns, BLACK, WHITE),
}
