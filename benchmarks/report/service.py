"""The service: under load, attacked, and killed at random."""

from __future__ import annotations

from functools import cache
from typing import Any

from benchmarks.report.plots import COLOURS
from benchmarks.report.results import Row, load, rows
from benchmarks.tables import MISSING, table

CHAOS = ("service/chaos-sqlite", "service/chaos-postgresql")
DECODE = "GET /decode/ID.png"
SHOWN = 10  # attacks in the table


@cache
def attacks() -> list[Row]:
    """The attacks, with the one that slows others the most first."""
    return sorted(rows("service/attacks"), key=lambda row: -row["others_worst_p99_ms"])


def situations() -> str:
    """Rows for load, then for the attacks that slow others the most."""
    lines: list[list[Any]] = []
    for row in rows("service/load"):
        of = row["spreads"][DECODE]
        what = f"during an encode: {row['case'].partition(',')[0]}, {row['rate']:g} a second"
        lines.append([what, f"`{DECODE}`", f"{of['p50_ms']:,.0f}", f"{of['p99_ms']:,.0f}", of["failed"], MISSING])
    for row in attacks()[:SHOWN]:
        asked, worst = max(row["others"].items(), key=lambda item: item[1]["p99_ms"])
        what = f"under attack: {row['words']}" + (f", {row['at_once']:,} at once" if row["at_once"] else "")
        times = f"{worst['p50_ms']:,.0f}", f"{worst['p99_ms']:,.0f}"
        lines.append([what, f"`{asked}`", *times, row["others_failed"], f"{row['web_mb']['most']:.0f}"])
    return table("situation | request | p50 ms | p99 ms | failed | web process, MB", lines)


def figures() -> dict[str, float]:
    """The figures of sentences, by mark."""
    found: dict[str, float] = {}
    for row in rows("service/load"):
        of, source = row["spreads"][DECODE], row["case"].partition(",")[0].replace(" ", "-")
        mark = f"service.{source}-{row['rate']:g}"
        found |= {f"{mark}-p50": of["p50_ms"], f"{mark}-p99": of["p99_ms"]}
        found[f"{mark}-failed"] = 100 * of["failed"] / of["requests"]
    met = [row["met"] for row in attacks() if row["attack"] != "none"]
    found["service.attacked-p99"] = attacks()[0]["others_worst_p99_ms"]
    found["service.limit-p99"] = load("service/attacks")["settings"]["at_most"]["p99_ms"]
    found["service.attacked-failed"] = sum(row["others_failed"] for row in attacks())
    found["service.attacks"], found["service.attacks-met"] = len(met), sum(met)
    killed = [rows(name)[0] for name in CHAOS]
    for mark, name in {"jobs": "accepted", "lost": "lost", "twice": "published twice"}.items():
        found[f"service.{mark}"] = sum(row["ledger"][name] for row in killed)
    found["service.crashed"] = sum(row["ledger"].get("failed because crashed", 0) for row in killed)
    happened = [item for row in killed for item in row["happened"].items()]
    return found | {"service.kills": sum(count for name, count in happened if "killed" in name)}


def draw(axes: Any) -> None:
    """A bar for each attack, the worst at the top."""
    worst_last = attacks()[::-1]
    axes.barh([r["words"] for r in worst_last], [r["others_worst_p99_ms"] for r in worst_last], color=COLOURS[1])
    limit = load("service/attacks")["settings"]["at_most"]["p99_ms"]
    axes.axvline(limit, color=COLOURS[2], linestyle="--", label="limit")
    axes.set(xlabel="milliseconds")  # not logarithmic: a bar says by its length how long it takes
    axes.tick_params(axis="y", labelsize=7)
