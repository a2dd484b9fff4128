"""Reading and writing for the commands. Errors are one sentence with the path as given."""

from __future__ import annotations

import errno
import os
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from sgmethod.cli.arguments import one_line
from sgmethod.cli.terminal import silent_stderr
from sgmethod.errors import BitstreamError, ImageError, SgError, noted
from sgmethod.io.files import write_atomically

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

STREAM = "-"  # standard input, or output
STDOUT_NAMES = ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")
MAX_INPUT_BYTES = 1 << 30  # the largest picture that is read takes 800 MB uncompressed; a device never ends


class CommandError(SgError):
    """The reason why a command failed, in one sentence."""


def read(path: str) -> bytes:
    """Read a file or standard input, of at most MAX_INPUT_BYTES."""
    data = bytearray()
    with _command_errors("read", path), _opened(path) as file:
        while block := file.read(1 << 20):
            data += block
            if len(data) > MAX_INPUT_BYTES:
                raise CommandError(f"cannot read {name_of(path)}: it is larger than {MAX_INPUT_BYTES:,} bytes")
    return bytes(data)


def read_pixels(image: bytes, *, keep_alpha: bool = False) -> tuple[NDArray[np.uint8], list[str]]:
    """Decode an image file to pixels [H, W, 3 or 4]; also return notes on anything dropped. Raises ImageError."""
    from sgmethod.io.image import read_image_8_bit

    with silent_stderr(), noted() as notes:  # libtiff prints lines of its own
        pixels = read_image_8_bit(image, keep_alpha=keep_alpha)
    return pixels, notes


def print_lines(kind: str, path: str, texts: Iterable[str]) -> None:
    """Print lines about a file to stderr, if that can be written."""
    with suppress(OSError):
        for text in texts:
            print(f"sgmethod: {kind}: {one_line(name_of(path))}: {one_line(text)}", file=sys.stderr)


@contextmanager
def _opened(path: str) -> Iterator[BinaryIO]:
    if path != STREAM:
        with Path(path).open("rb") as file:
            yield file
    elif sys.stdin is None or sys.stdin.isatty():
        raise CommandError("standard input is a terminal or closed: pipe a file into it with < or |")
    else:
        yield sys.stdin.buffer


def write(path: str, data: bytes) -> None:
    """Write to standard output, or to a file, completely or not at all."""
    with _command_errors("write", path):
        if path == STREAM:
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
        else:
            write_atomically(path, data)


def output(path: str) -> str:
    """Return STREAM for a name of standard output, any other path unchanged.

    Opened a second time, standard output would be overwritten from its start, and mixed with our own messages.
    """
    return STREAM if path in STDOUT_NAMES else path


def listed(folder: str) -> list[Path]:
    """List a folder's files and broken links by name, without pipes, which might block. Raises CommandError."""
    with _command_errors("read", folder):
        found = (path for path in Path(folder).iterdir() if path.is_file() or not path.exists())
        return sorted(found, key=lambda path: path.name)  # paths of Windows compare without case


def name_of(path: str, stream: str = "standard input") -> str:
    """Name a path in a message."""
    return stream if path == STREAM else path


@contextmanager
def _command_errors(verb: str, path: str) -> Iterator[None]:
    """Turn OSError into a CommandError with the path as given."""
    try:
        yield
    except BrokenPipeError:  # the reader has gone, which main() does not treat as an error
        raise
    except OSError as error:
        stream = "standard input" if verb == "read" else "standard output"
        raise CommandError(f"cannot {verb} {name_of(path, stream)}: {error.strerror or error}") from error


@contextmanager
def contents_of(path: str) -> Iterator[None]:
    """Turn errors in a file's contents into a CommandError that names the file."""
    try:
        yield
    except (ImageError, BitstreamError) as error:
        raise CommandError(f"{name_of(path)}: {error}") from error


def check_outputs(sources: Sequence[str], outputs: Sequence[str]) -> None:
    """Raise CommandError if an output cannot be written, or would replace an input or another output."""
    for path in outputs:
        if path == STREAM:
            if sys.stdout is None or sys.stdout.isatty():
                raise CommandError("standard output is a terminal or closed: name a file, or redirect it with > or |")
        else:
            with _command_errors("write", path):
                _check_writable(Path(path))
    taken: dict[str, str] = {os.path.realpath(path): path for path in sources if not is_device(path)}
    for path in outputs:
        if is_device(path):
            continue
        if (real := os.path.realpath(path)) in taken:
            raise CommandError(f"{path} is used twice: inputs and outputs must be different files")
        taken[real] = path


def is_device(path: str) -> bool:
    """Whether the path is a stream or device instead of a regular file."""
    return path == STREAM or (Path(path).exists() and not Path(path).is_file() and not Path(path).is_dir())


def make_folder(path: str) -> None:
    """Create a folder and its parents. Raises CommandError."""
    with _command_errors("write", path):
        Path(path).mkdir(parents=True, exist_ok=True)


def _check_writable(target: Path) -> None:
    """Raise the OSError that writing would. Links are left to the system: one to a pipe has no path."""
    mode = None
    with suppress(FileNotFoundError):
        mode = target.stat().st_mode
    if mode is not None and stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if mode is not None and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    if mode is None or stat.S_ISREG(mode):
        with tempfile.TemporaryFile(dir=Path(os.path.realpath(target)).parent):
            pass
