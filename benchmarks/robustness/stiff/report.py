"""The report: how often each rule was checked and broken, then each picture, then every violation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.robustness.stiff.rows import Row
from benchmarks.robustness.stiff.rules import RULES, Check
from benchmarks.tables import table


def counted(checks: Sequence[Check]) -> list[dict[str, Any]]:
    """For each rule the rows checked, the violations and the worst of them; plain JSON types."""
    lines = []
    for name, rule in RULES.items():
        own = [check for check in checks if check.rule == name]
        broken = [check for check in own if check.broken]
        worst = max(broken, key=lambda check: check.by, default=None)
        line = {"rule": name, "checked": len(own), "broken": len(broken), "tolerance": rule.tolerance}
        lines.append({**line, "unit": rule.unit, "worst": worst and violation(worst)})
    return lines


def violation(check: Check) -> dict[str, Any]:
    """Which rule was broken, where and by how much; plain JSON types."""
    row = check.row
    where = {"picture": row.picture, "seed": row.seed, "kind": row.kind, "value": row.value}
    return {"rule": check.rule, "by": round(check.by, 4), **where}


def report(rows: Sequence[Row], checks: Sequence[Check]) -> str:
    """Markdown: a line for each rule, then one for each picture."""
    rules = []
    for line in counted(checks):
        worst = "-" if line["worst"] is None else f"{line['worst']['by']:.4g}: {_where(line['worst'])}"
        allowed = f"{line['tolerance']:g} {line['unit']}"
        rules.append([line["rule"], allowed, line["checked"], line["broken"], worst])
    lines = []
    for picture in dict.fromkeys(row.picture for row in rows):
        own = [row for row in rows if row.picture == picture]
        broken = [check.rule for check in checks if check.broken and check.row.picture == picture]
        names = ", ".join(f"{name} {broken.count(name)}" for name in RULES if name in broken) or "-"
        lines.append([picture, len(own), sum(row.refused is not None for row in own), len(broken), names])
    by_rule = table("rule | allowed | rows checked | violations | the worst", rules)
    return f"{by_rule}\n\n{table('picture | rows | too small a budget | violations | of the rules', lines)}"


def _where(found: dict[str, Any]) -> str:
    return f"{found['picture']}, seed {found['seed']}, {found['kind']} {found['value']:g}"
