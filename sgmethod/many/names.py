"""Names of the files of a run, each another on every file system."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from unicodedata import normalize

from sgmethod.errors import SgError


class Names:
    """The names taken in a folder.

    Some file systems ignore case (exFAT, SMB, those of Windows and macOS), or whether é is one character or two
    (macOS): there, two names may be one file. Names do not depend on the file system, so that the same pictures give
    the same files everywhere: of two names that are one anywhere, the later becomes its alternative. The file system
    is asked only where there is none.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._taken: dict[str, list[tuple[str, str]]] = {}  # by what is ignored, names and their sources

    def take(self, source: str, name: str, alternative: str | None = None) -> str:
        """Return the name of a source's file, or the alternative if another source has taken one like it.

        Raises SgError if that is taken too, or if the sources are files of the same name: their alternatives would be.
        """
        like = self._like(name)
        if alternative is not None and like and all(Path(source).name != Path(owner).name for _, owner in like):
            name, like = alternative, self._like(alternative)
        for other, owner in like:
            if name == other or self._are_one(name, other):
                raise SgError(f"{owner} and {source} would both become {self._folder / name}")
        like.append((name, source))
        return name

    def _like(self, name: str) -> list[tuple[str, str]]:
        return self._taken.setdefault(normalize("NFC", name.casefold()), [])

    def _are_one(self, name: str, other: str) -> bool:
        """Ask the file system whether two names are one file. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".names.", dir=self._folder) as empty:
            (Path(empty) / other).touch()
            return (Path(empty) / name).exists()
