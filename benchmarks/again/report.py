"""Whether the figures came out again."""

from __future__ import annotations

from benchmarks.report.section import Content, Section, table


def section(content: Content) -> Section:
    """From again.json."""
    rows = content["rows"]
    drawn, made, different = (sum(counts) for counts in zip(*map(counted, rows), strict=True))
    lines = [[row["result"], row["commit"], f"{row['of']:,}", *counted(row)] for row in rows]
    told = "; ".join(f"{row['result']}: {in_words(one)}" for row in rows for one in row["different"])
    said = (
        f"Does the code of commit {content['commit']} make the figures that earlier code has made? Of {drawn} rows, "
        f"drawn by chance from those that no clock decides, {made} were made again by the command below their table, "
        f"and {different or 'none'} came out with other bytes or another figure{f' ({told})' if told else ''}. "
        "Figures of LPIPS and the like may differ by a hundred-thousandth. Times, and what is fitted for so many "
        "seconds, are not looked at; nor are rows that were put in from a second command, which count as not made."
    )
    titles = "result | of commit | rows | drawn | made again | different"
    return Section("again", "The same figures again", said, [table(titles, lines)], [content])


def counted(row: Content) -> tuple[int, int, int]:
    """Rows that were drawn, made again, and different."""
    return row["drawn"], row["made"], len(row["different"])


def in_words(one: Content) -> str:
    """A row that is different, and by how much."""
    what = " ".join(str(value) for name, value in one.items() if name != "by")
    return f"{what} by {', '.join(f'{value:.3g} of {name}' for name, value in one['by'].items())}"
