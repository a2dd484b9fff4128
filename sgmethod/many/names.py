"""Names of the files of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from unicodedata import normalize

from sgmethod.errors import SgError


class Names:
    """The names taken in a folder.

    Some file systems ignore case (exFAT, SMB, those of Windows and macOS), or whether é is one character or two
    (macOS): there, two names may be one file. Of two pictures' names that differ by no more, the later becomes its
    alternative, on every file system.

    before: names of files that earlier runs have made, and of the pictures that these were made from. Such a name is
    taken by a picture of the same name alone.
    """

    def __init__(self, folder: Path, before: Mapping[str, str] | None = None) -> None:
        self._folder = folder
        self._taken: dict[str, dict[str, str]] = {}  # by what is ignored, names and their sources
        self._owners: dict[str, set[str]] = {}
        for name, picture in (before or {}).items():
            self._owners.setdefault(_like(name), set()).add(picture)

    def take(self, source: str, name: str, alternative: str | None = None) -> str:
        """Return the name of a source's file, or the alternative if another source has taken one like it.

        Raises SgError if that is taken too, or if the sources are files of the same name: their alternatives would be.
        """
        if alternative is not None and self._is_of_another(source, name, alternative):
            name = alternative
        taken = self._taken.setdefault(_like(name), {})
        if name in taken:
            raise SgError(f"{taken[name]} and {source} would both become {self._folder / name}")
        taken[name] = source
        return name

    def _is_of_another(self, source: str, name: str, alternative: str) -> bool:
        """Whether a name belongs to another picture, of this run or an earlier one."""
        picture = Path(source).name
        taken = [Path(owner).name for owner in self._taken.get(_like(name), {}).values()]
        owners, others = (self._owners.get(_like(one), set()) for one in (name, alternative))
        return bool((taken and picture not in taken) or (picture not in owners and (owners or picture in others)))


def _like(name: str) -> str:
    return normalize("NFC", name.casefold())
