"""Stiff and extreme cases."""

from __future__ import annotations

from collections import Counter
from typing import Any

from benchmarks.report.section import Content, Section, number, table
from benchmarks.stiff.rules import RULES

SETS = {
    "kernels": "(b) Kernels against float64, every instruction set and number of threads",
    "fits": "(c) Fits",
    "files": "(d) Files",
}


def section(stiff: Content | None, content: Content | None) -> Section:
    """From the stiff set and stability.json, as far as there are."""
    rows = joined(content["rows"]) if content else []
    broken = [row for row in rows if row["verdict"] == "broken"]
    rules = stiff["rules"] if stiff else []
    failing = sum(rule["broken"] > 0 for rule in rules)
    said = (
        "What happens where pictures are hard to code, numbers extreme, starts bad and files damaged? "
        f"{_counted(rules, failing, rows, len(broken))} Only what somebody thought of is tried, and a rule that is "
        "kept on these cases may be broken on others."
    )
    tables = [stiff_table(stiff)] if stiff else []
    for name, title in SETS.items():
        if own := [row for row in rows if row["set"] == name]:
            make = kernels_table if name == "kernels" else cases_table
            tables.append(f"{title}\n\n{make(own)}")
    return Section("stability", "Stiff and extreme cases", said, tables, [one for one in (stiff, content) if one])


def _counted(rules: list[Any], failing: int, rows: list[Any], broken: int) -> str:
    parts = [f"{failing} of {len(rules)} rules are broken somewhere on pictures that are hard to code"] if rules else []
    parts += [f"{broken} of {len(rows)} extreme cases break their rule"] if rows else []
    return f"{'; '.join(parts)}."


def stiff_table(content: Content) -> str:
    """The rules of profile rd on pictures that are hard to code, and where each is broken worst."""
    lines = []
    for rule in content["rules"]:
        worst, where = rule["worst"], "-"
        if worst is not None:
            where = f"{worst['by']:.4g} ({worst['picture']}, {worst['kind']} {worst['value']:g})"
        verdict = "kept" if rule["broken"] == 0 else f"broken {rule['broken']} times"
        says = RULES[rule["rule"]].find.__doc__ or ""
        lines.append(
            [rule["rule"], says.rstrip("."), f"{rule['tolerance']:g} {rule['unit']}", rule["checked"], where, verdict]
        )
    made = table("rule | what it says | allowed | checked | the worst | verdict", lines)
    return f"(a) Pictures that are hard to code\n\n{made}"


def kernels_table(rows: list[dict[str, Any]]) -> str:
    """A line for each set of Gaussians, a column for each rule."""
    rules = list(dict.fromkeys(row["rule"] for row in rows))
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        own = {row["rule"]: row for row in rows if row["case"] == case}
        broken = [f"broken: {number(row['worst'], '.3g')}" for row in own.values() if row["verdict"] == "broken"]
        figures = [number(own[rule]["worst"], ".2g") if rule in own else "-" for rule in rules]
        free = any(row["limit"] is None for row in own.values())
        lines.append(
            [
                case,
                *figures,
                ", ".join(broken) or ("kept; gradients have no limit at such a ratio" if free else "kept"),
            ]
        )
    limits = {row["rule"]: row["limit"] for row in rows if row["limit"] is not None}
    named = [f"{rule}, at most {limits[rule]:g}" if rule in limits else rule for rule in rules]
    return table(" | ".join(["case", *named, "verdict"]), lines)


def cases_table(rows: list[dict[str, Any]]) -> str:
    """Each case in one line."""
    lines = []
    for row in rows:
        limit = "-" if row["limit"] is None else f"{row['limit']:g}"
        worst = "no number" if row["worst"] is None else number(row["worst"], ".3g")
        lines.append([row["case"], row["rule"], limit, worst, row["verdict"], row["note"].replace("|", "/")])
    return table("case | rule | allowed | the worst | verdict | more", lines)


def joined(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows, with all mutations as one."""
    parts = [row for row in rows if row["case"].startswith("mutations ")]
    if len(parts) < 2:
        return rows
    verdicts = Counter(row["verdict"] for row in parts)
    last = parts[-1]["case"].rsplit(" ", 1)[-1]
    notes = "; ".join(row["note"] for row in parts if row["verdict"] == "broken")
    whole = {**parts[0], "case": f"mutations 0 to {last}", "worst": max(row["worst"] or 0 for row in parts)}
    whole |= {"verdict": "broken" if verdicts["broken"] else "kept", "note": notes or f"{len(parts)} parts"}
    return [whole, *(row for row in rows if row not in parts)]
