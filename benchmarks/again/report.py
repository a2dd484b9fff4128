"""Whether the figures came out again."""

from __future__ import annotations

from benchmarks.report.section import Content, Section, number, table


def section(content: Content) -> Section:
    """From again.json."""
    rows = content["rows"]
    drawn, made, different = (sum(counted(row)[k] for row in rows) for k in range(3))
    lines = [[row["result"], row["commit"], f"{row['of']:,}", *counted(row)] for row in rows]
    told = "; ".join(f"{row['result']}: {in_words(one)}" for row in rows for one in row["different"])
    seen = "LPIPS and DISTS to five digits" if content["settings"]["seen"] else "but for LPIPS and DISTS"
    said = (
        f"Does the code of commit {content['commit']} make what the results of earlier code say? Of {drawn} rows, "
        f"drawn by chance from those that no clock decides, {made} were made again by the command below their table, "
        f"and {different or 'none'} came out with other bytes or another figure{f' ({told})' if told else ''}. All "
        f"figures are compared, {seen}; times are not, nor what is fitted for so many seconds. A row is not made again "
        "where it came from a second command, which the remark below its table names, or time ran out."
    )
    titles = "result | of commit | rows drawn from | drawn | made again | different"
    return Section("again", "The same figures again", said, [table(titles, lines)], [content])


def counted(row: Content) -> tuple[int, int, int]:
    """Rows that were drawn, made again, and different."""
    return row["drawn"], row["made"], len(row["different"])


def in_words(one: Content) -> str:
    """A row that is different, with what it was and what it is."""
    what = " ".join(str(value) for name, value in one.items() if name != "figures" and value is not None)
    figures = one["figures"].items()
    changes = [f"{name} {number(was, '.7g')} then, {number(now, '.7g')} now" for name, (was, now) in figures]
    return f"{what}, {', '.join(changes)}"
