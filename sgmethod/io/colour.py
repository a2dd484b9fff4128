"""Colour conversion: from the colour spaces that files state to sRGB.

A file states its colours by the code points of H.273 (PNG's cICP, AVIF's and HEIC's nclx), by an ICC profile, or, only
in PNG, by sRGB, gAMA and cHRM. Colours defined by curves and primaries are converted here, because Pillow's Little CMS
takes only 8 bits, which are too few for the dark levels of linear light. Little CMS converts the rest (CMYK, tables).
Both conversions are relative colorimetric: white becomes white.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sgmethod.errors import ImageError

Levels = NDArray[np.integer[Any]]
Values = NDArray[np.floating[Any]]
Curve = Callable[[Values], Values]  # values in a file -> linear light, both in [0, 1]
Matrix = NDArray[np.float64]

BAND = 1 << 18  # pixels converted at a time: a whole picture in floats would take more memory than an encode
MAX_PROFILE_BYTES = 16 << 20  # inflated; profiles of printing presses have one or two MiB
MIN_VISIBLE_CHANGE = 0.75 / 255  # a conversion that moves no colour further is skipped

# H.273, tables 2 and 3: x and y of red, green, blue and white; transfer curves. Those of video are treated as sRGB, as
# screens show them.
D65, D50 = (0.3127, 0.3290), (0.3457, 0.3585)
BT709 = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D65)
PRIMARIES = {
    1: BT709,
    2: BT709,  # unspecified
    4: ((0.67, 0.33), (0.21, 0.71), (0.14, 0.08), (0.310, 0.316)),
    5: ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06), D65),
    6: ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65),
    7: ((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65),
    9: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
    11: ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), (0.314, 0.351)),
    12: ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), D65),
    22: ((0.630, 0.340), (0.295, 0.605), (0.155, 0.077), D65),
}
PQ, HLG = 16, 18
SRGB_LIKE = (1, 2, 6, 13, 14, 15)
GAMMAS = {4: 2.2, 5: 2.8, 8: 1.0}
GAMMA_THRESHOLD = 0.05  # libpng's: a gAMA this close to 1 / 2.2 means sRGB


class ProfileError(Exception):
    """The colour profile cannot be used, for the reason in the message."""


def from_srgb(values: Values) -> Values:
    """Convert sRGB values to linear light, both in [0, 1] (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4)


def to_srgb(light: Values) -> Values:
    """Convert linear light to sRGB values, both in [0, 1] (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def _gamma(exponent: float) -> Curve:
    return lambda values: values**exponent


def _xyz(x: float, y: float) -> Matrix:
    return np.array([x / y, 1, (1 - x - y) / y])


def _to_d50(primaries: tuple[tuple[float, float], ...]) -> Matrix:
    """Matrix [3, 3] from light of the primaries to XYZ under D50, by Bradford's adaptation (ICC.1:2022, annex E)."""
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    *colours, white = (_xyz(x, y) for x, y in primaries)
    plain = np.stack(colours, 1)
    plain = plain * np.linalg.solve(plain, white)
    cones = np.diag((bradford @ _xyz(*D50)) / (bradford @ white))
    return np.asarray(np.linalg.inv(bradford) @ cones @ bradford @ plain)


@dataclass(frozen=True)
class Space:
    """An RGB or grey colour space: curves to linear light, and the matrix from there to sRGB's light."""

    curves: tuple[Curve, ...]
    matrix: Matrix | None

    @classmethod
    def from_curves(cls, curves: tuple[Curve, ...], to_d50: Matrix | None) -> Space | None:
        """Build a space; None if it is sRGB. Raises ProfileError if it does not describe colours."""
        space = cls(curves, None if to_d50 is None else np.linalg.inv(_to_d50(BT709)) @ to_d50)
        side = np.linspace(0, 1, 9)
        probe = np.stack(np.meshgrid(*[side] * len(curves), indexing="ij"), -1).reshape(-1, len(curves))
        with np.errstate(all="ignore"):
            converted = space._converted([curve(values) for curve, values in zip(curves, probe.T, strict=True)])
        if not np.isfinite(converted).all() or np.ptp(converted, 0).min() < 0.1:
            raise ProfileError("it does not describe colours")
        return None if np.abs(converted - probe).max() < MIN_VISIBLE_CHANGE else space

    def _converted(self, light: list[Values]) -> Values:
        stacked = np.stack(light, -1)
        if self.matrix is not None:
            stacked = stacked @ self.matrix.T.astype(stacked.dtype)
        return to_srgb(np.clip(stacked, 0, 1))

    def convert(self, levels: Levels, peak: int) -> tuple[Levels, int]:
        """Convert levels [H, W, 1 or 3] to sRGB levels; return them and their white.

        peak: white of the input. The output has 8 bits for a peak of 255, else 16.
        """
        if len(self.curves) > levels.shape[2]:
            levels = np.broadcast_to(levels, (*levels.shape[:2], len(self.curves)))
        curves = self.curves * (levels.shape[2] // len(self.curves))
        tables = [curve(np.linspace(0, 1, peak + 1)).astype(np.float32) for curve in curves]
        to_peak, kind = (255, np.uint8) if peak == 255 else (65535, np.uint16)
        converted = np.empty(levels.shape, kind)
        rows = max(BAND // levels.shape[1], 1)
        for start in range(0, len(levels), rows):
            band = levels[start : start + rows]
            light: list[Values] = [table[band[..., channel]] for channel, table in enumerate(tables)]
            converted[start : start + rows] = np.rint(self._converted(light) * to_peak)
        return converted, to_peak


class Transform:
    """Conversion by Little CMS from any ICC profile, relative colorimetric with black-point compensation."""

    def __init__(self, profile: bytes, mode: str) -> None:
        """Parse a profile. mode: Pillow's name for the samples, "L", "RGB" or "CMYK". Raises ProfileError."""
        from PIL import ImageCms

        self.mode = mode
        try:
            self._transform = ImageCms.buildTransform(
                ImageCms.ImageCmsProfile(io.BytesIO(profile)),
                ImageCms.createProfile("sRGB"),
                mode,
                "RGB",
                ImageCms.Intent.RELATIVE_COLORIMETRIC,
                ImageCms.Flags.BLACKPOINTCOMPENSATION,
            )
        except (ImageCms.PyCMSError, OSError, ValueError) as error:
            raise ProfileError("it cannot be read") from error

    def convert(self, levels: Levels, peak: int) -> tuple[Levels, int]:
        """Convert levels [H, W, bands of the mode] to 8-bit sRGB levels; return them and their white."""
        if peak != 255:
            levels = (levels.astype(np.uint32) * 255 + peak // 2) // peak
        samples = np.ascontiguousarray(levels.astype(np.uint8, copy=False))
        if self.mode == "L":
            samples = samples[..., 0]
        elif self.mode == "RGB" and samples.shape[2] == 1:
            samples = np.ascontiguousarray(np.broadcast_to(samples, (*samples.shape[:2], 3)))
        height, width = samples.shape[:2]
        image = Image.frombuffer(self.mode, (width, height), samples.tobytes(), "raw", self.mode, 0, 1)
        return np.asarray(self._transform.apply(image)), 255


Colour = Space | Transform | None  # None: sRGB already


def from_code_points(primaries: int, transfer: int) -> Colour:
    """Colours stated by code points (H.273). Raises ImageError for PQ and HLG, ProfileError for unknown ones."""
    if transfer in (PQ, HLG):
        name = "PQ" if transfer == PQ else "HLG"
        raise ImageError(f"high dynamic range ({name}) is not supported; convert the picture to SDR first")
    if primaries not in PRIMARIES or transfer not in (*SRGB_LIKE, *GAMMAS):
        raise ProfileError(f"unknown code points {primaries} and {transfer}")
    curve = from_srgb if transfer in SRGB_LIKE else _gamma(GAMMAS[transfer])
    return Space.from_curves((curve,) * 3, _to_d50(PRIMARIES[primaries]))


def from_gamma(info: Mapping[Any, Any]) -> Colour:
    """Colours stated by a PNG's gAMA and cHRM, in Pillow's `info`. Raises ProfileError."""
    gamma, points = info.get("gamma"), info.get("chromaticity")
    if gamma is None and points is None:
        return None
    if gamma is not None and not gamma > 0:
        raise ProfileError("its gamma is zero")
    curve = from_srgb if gamma is None or abs(gamma * 2.2 - 1) < GAMMA_THRESHOLD else _gamma(1 / gamma)
    primaries = BT709
    if points is not None:
        white, red, green, blue = zip(points[0::2], points[1::2], strict=True)
        primaries = (red, green, blue, white)
    try:
        to_d50 = _to_d50(primaries)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise ProfileError("its primaries are invalid") from error
    return Space.from_curves((curve,) * 3, to_d50)


def inflate(iccp: bytes) -> bytes:
    """Inflate the profile in PNG's iCCP: name, zero byte, compression method, zlib stream. Raises ProfileError."""
    inflater = zlib.decompressobj()
    try:
        profile = inflater.decompress(iccp[iccp.find(b"\0") + 2 :], MAX_PROFILE_BYTES)
    except zlib.error as error:
        raise ProfileError("it is damaged") from error
    if not inflater.eof:
        raise ProfileError(f"it is truncated, or larger than {MAX_PROFILE_BYTES >> 20} MiB")
    return profile


def from_profile(profile: bytes, mode: str) -> Colour:
    """Colours stated by an ICC profile, for samples of Pillow's mode "L", "RGB" or "CMYK".

    Raises ProfileError for a profile that is damaged or has other channels, ImageError for PQ and HLG.
    """
    tags = _tags(profile)
    if (cicp := tags.get(b"cicp")) and len(cicp) >= 10 and cicp[9] in (PQ, HLG):
        return from_code_points(cicp[8], cicp[9])
    channels = {b"GRAY": "L", b"RGB ": "RGB", b"CMYK": "CMYK"}.get(profile[16:20])
    if channels != mode and (channels, mode) != ("RGB", "L"):  # grey samples may have an RGB profile
        raise ProfileError("its channels do not match the picture's")
    names = (b"kTRC",) if channels == "L" else (b"rTRC", b"gTRC", b"bTRC")
    by_table = any(name in tags for name in (b"A2B0", b"A2B1", b"D2B0", b"D2B1"))
    if channels == "CMYK" or by_table or profile[20:24] != b"XYZ " or not all(name in tags for name in names):
        return Transform(profile, channels or mode)
    try:
        curves = tuple(_curve(tags[name]) for name in names)
        if channels == "L":
            return Space.from_curves(curves, None)
        return Space.from_curves(curves, np.stack([_xyz_of(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ")], 1))
    except (struct.error, KeyError, IndexError) as error:
        raise ProfileError("it is damaged") from error


def _tags(profile: bytes) -> dict[bytes, memoryview]:
    """Tags of an ICC profile by name (ICC.1:2022, 7.2 and 7.3). Raises ProfileError."""
    if len(profile) < 132 or profile[36:40] != b"acsp":
        raise ProfileError("it is not an ICC profile")
    (count,) = struct.unpack_from(">I", profile, 128)
    if 132 + 12 * count > len(profile):
        raise ProfileError("it is truncated")
    entries = struct.iter_unpack(">4sII", profile[132 : 132 + 12 * count])
    whole = memoryview(profile)  # thousands of tags may share the same bytes
    return {name: whole[start : start + length] for name, start, length in entries}


def _xyz_of(tag: memoryview) -> Matrix:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536


def _curve(tag: memoryview) -> Curve:
    """Curve of a tag of type curv or para (ICC.1:2022, 10.6 and 10.18). Raises ProfileError."""
    name = bytes(tag[:4])
    if name == b"para":
        (kind,) = struct.unpack_from(">H", tag, 8)
        return _parametric(kind, [value / 65536 for value in struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", tag, 12)])
    if name != b"curv":
        raise ProfileError("it has curves of an unknown type")
    (count,) = struct.unpack_from(">I", tag, 8)
    if count == 0:
        return _gamma(1)
    if count == 1:
        return _gamma(struct.unpack_from(">H", tag, 12)[0] / 256)
    if 12 + 2 * count > len(tag):
        raise ProfileError("it is truncated")
    values = np.frombuffer(tag, ">u2", count, 12) / 65535
    return lambda x: np.interp(x, np.linspace(0, 1, count), values)


def _parametric(kind: int, parameters: list[float]) -> Curve:
    """Parametric curve: Y = (a X + b)^g + e from X = d on, and c X + f below."""
    g, a, b, c, d, e, f = (parameters + [0.0] * 7)[:7]
    if kind == 0:
        a, d = 1, -1
    elif kind in (1, 2):
        e = f = c
        c, d = 0, -b / a if a else 0
    return lambda x: np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f)
