"""Input and output names of conversions."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from sgmethod.cli import paths
from sgmethod.cli.paths import STREAM, CommandError
from sgmethod.io.formats import SUFFIXES
from sgmethod.many.manifest import Row
from sgmethod.many.names import Names

SUFFIX = ".sg"
PICTURES = SUFFIXES


@dataclass(frozen=True)
class Conversion(Row):
    """An input and its output; once it is made, its line in the manifest, and a summary."""

    input: str
    target: str = ""
    summary: str = ""

    @classmethod
    def from_paths(cls, source: str, target: str) -> Conversion:
        """Create the conversion of a path to another."""
        return cls(Path(target).name, source, target=target)


def sg_beside(source: str) -> str:
    """Name photo.jpg photo.sg, in the same folder; unknown extensions are kept."""
    return _renamed(source, {*PICTURES, SUFFIX}, SUFFIX)


def png_beside(source: str) -> str:
    """Name photo.sg photo.png, in the same folder."""
    return _renamed(source, {SUFFIX}, ".png")


def _renamed(source: str, known: set[str], suffix: str) -> str:
    path = Path(source)
    return str(path.with_suffix(suffix) if path.suffix.lower() in known else path.with_name(path.name + suffix))


def encode(arguments: argparse.Namespace) -> Conversion:
    """Name the output of encode for a single picture. Raises CommandError."""
    if arguments.resume:
        raise CommandError("--resume needs --output-dir")
    source, target = _pair(arguments, "out.sg")
    if target is None:
        if Path(source).is_dir():
            raise CommandError(f"{source} is a folder: to encode the pictures in it, use --output-dir out")
        if source.lower().endswith(SUFFIX):
            raise CommandError(f"{source} is named like an .sg file; if it is a picture, name the output too")
        target = STREAM if source == STREAM else sg_beside(source)
    elif not (target.lower().endswith(SUFFIX) or paths.is_device(target)):
        raise CommandError(f"the output {target} must end in .sg; to encode several pictures, use --output-dir out")
    return Conversion.from_paths(source, target)


def decodes(arguments: argparse.Namespace) -> list[Conversion]:
    """List the conversions of decode, .sg files to pictures. Raises CommandError."""
    if arguments.output_dir is not None:
        return into_folder(arguments, {SUFFIX}, png_beside)
    source, target = _pair(arguments, "out.png")
    if target is None:
        raise CommandError("OUT is missing: name a picture, such as out.png, or use --output-dir out")
    return [Conversion.from_paths(source, target)]


def _pair(arguments: argparse.Namespace, example: str) -> tuple[str, str | None]:
    names = [*arguments.names, *([] if arguments.output is None else [arguments.output])]
    if len(names) > 2:
        raise CommandError(
            f"{len(names)} names given, expected an input and an output such as {example}; "
            "for several inputs, use --output-dir out"
        )
    return names[0], paths.output(names[1]) if len(names) == 2 else None


def into_folder(
    arguments: argparse.Namespace,
    known: set[str],
    renamed: Callable[[str], str],
    before: Mapping[str, str] | None = None,
) -> list[Conversion]:
    """List conversions of files, and of folders' files with a known extension, into the output folder.

    Where a.jpg has taken the name of a.png, that keeps its extension: a.sg and a.png.sg. before: names that earlier
    runs gave, as in Names. Raises SgError.
    """
    if arguments.output is not None:
        raise CommandError("--output cannot be combined with --output-dir")
    if STREAM in arguments.names:
        raise CommandError("--output-dir cannot be combined with standard input")
    names, made = Names(Path(arguments.output_dir), before), []
    for source in (one for name in arguments.names for one in files_of(name, known)):
        short = Path(renamed(source))
        name = names.take(source, short.name, Path(source).name + short.suffix)
        made.append(Conversion.from_paths(source, str(Path(arguments.output_dir) / name)))
    paths.make_folder(arguments.output_dir)
    return made


def kind_of(target: str, kinds: Mapping[str, str], of_devices: str) -> str:
    """Return the format of an output by its extension. Raises CommandError for an unknown one."""
    kind = of_devices if paths.is_device(target) else kinds.get(Path(target).suffix.lower())
    if kind is None:
        raise CommandError(f"cannot write {target}: its name must end in one of {', '.join(kinds)}")
    return kind


def files_of(name: str, known: set[str]) -> Iterator[str]:
    """Yield a file's name, or a folder's files with a known extension, without hidden ones, by name."""
    if not Path(name).is_dir():
        yield name
        return
    found = [path for path in paths.listed(name) if path.suffix.lower() in known and not path.name.startswith(".")]
    if not found:
        raise CommandError(f"{name} contains no file ending in {', '.join(sorted(known))}")
    yield from map(str, found)
