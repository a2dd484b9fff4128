"""Headers as RFC 9110 reads them: several lines of one name are one line, with commas between them (5.3)."""

from __future__ import annotations

from starlette.datastructures import Headers


def joined(headers: Headers, name: str) -> str | None:
    """All lines of a header as one; None without any. Where one value alone is allowed, several are none."""
    lines = headers.getlist(name)
    return ", ".join(lines) if lines else None
