"""Stiff and extreme cases."""

from __future__ import annotations

import textwrap
from collections import Counter
from typing import Any

from benchmarks.report.section import Content, Section, number, table
from benchmarks.stiff.rules import RULES

SETS = {
    "kernels": "(b) Kernels against float64, every instruction set and number of threads",
    "fits": "(c) Fits",
    "files": "(d) Files",
}
NOTES = {
    "fits": ", of {side}x{side}, tuned for PSNR where nothing else is said. A Gaussian of a spoiled start is dropped "
    "or mended, and growth places what is missing. On so small a picture that can end ahead of the start as it is, "
    "which says that the start is worth little there."
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
            note = NOTES.get(name, "").format_map(content["settings"] if content else {})
            tables.append(f"{title}{note}\n\n{make(own)}")
    return Section("stability", "Stiff and extreme cases", said, tables, [one for one in (stiff, content) if one])


def _counted(rules: list[Any], failing: int, rows: list[Any], broken: int) -> str:
    parts = [f"{failing} of {len(rules)} rules are broken somewhere on pictures that are hard to code"] if rules else []
    held = [row for row in rows if row["limit"] is not None]
    cases = len({row["case"] for row in rows})
    free = f", and {len(rows) - len(held)} more have no limit" if len(held) < len(rows) else ""
    parts += [f"{broken} of {len(held)} checks on {cases} extreme cases are broken{free}"] if rows else []
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
    return f"(a) Pictures that are hard to code; [every file](../benchmarks/results/version4/stiff.json)\n\n{made}"


def kernels_table(rows: list[dict[str, Any]]) -> str:
    """A line for each set of Gaussians, a column for each rule."""
    rules = list(dict.fromkeys(row["rule"] for row in rows))
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        own = {row["rule"]: row for row in rows if row["case"] == case}
        broken = [f"broken: {number(row['worst'], '.3g')}" for row in own.values() if row["verdict"] == "broken"]
        figures = [number(own[rule]["worst"], ".2g") if rule in own else "-" for rule in rules]
        free = "; gradients have no limit at such a ratio" if any(row["limit"] is None for row in own.values()) else ""
        lines.append([case, *figures, (", ".join(broken) or "kept") + free])
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
    counts = (sum(int(row["note"].split()[k].replace(",", "")) for row in parts) for k in (0, 2))
    told = "{:,} drawn, {:,} refused".format(*counts)
    whole |= {"verdict": "broken" if verdicts["broken"] else "kept", "note": notes or told}
    return [whole, *(row for row in rows if row not in parts)]


def limits(stiff: Content | None, content: Content | None) -> str:
    """Every rule of the stiff set and every extreme case that is broken, for the README."""
    told = []
    if stiff:
        broken = [rule for rule in stiff["rules"] if rule["broken"]]
        rules = f"{len(stiff['rules'])} rules of the [stiff set](docs/results.md#stiff-and-extreme-cases)"
        words = "".join(f"\n  - {_broken(rule)}" for rule in broken)
        kept = f"{len(broken)} of {rules} are broken there:{words}" if broken else f"All {rules} are kept even there."
        told.append(f"- Some pictures do not suit Gaussians: lines, steps, single pixels, noise. {kept}")
    if content:
        cases = [
            f"{row['case']}, {number(row['worst'], '.2g')} where {row['limit']:g} is allowed ({row['rule']})"
            for row in content["rows"]
            if row["verdict"] == "broken"
        ]
        free = list(dict.fromkeys(row["case"] for row in content["rows"] if row["limit"] is None))
        none = f" Gradients were held to no limit with {'; '.join(free)}." if free else ""
        told.append(f"- Extreme cases that break their rule: {'; '.join(cases) or 'none that was tried'}.{none}")
    lines = [line for one in told for line in one.split("\n")]
    return "\n".join(_filled(line) for line in lines)


def _filled(line: str) -> str:
    """A line of a list, within 120 characters."""
    indent = " " * (line.index("- ") + 2)
    return textwrap.fill(line, 120, subsequent_indent=indent, break_long_words=False)


def _broken(rule: dict[str, Any]) -> str:
    """One rule of the stiff set, in a sentence."""
    says, worst = (RULES[rule["rule"]].find.__doc__ or "").rstrip("."), rule["worst"]
    return (
        f'"{says}": by {rule["broken"]} of {rule["checked"]} files, by {worst["by"]:.2g} {rule["unit"]} at most '
        f"({worst['picture']})."
    )
