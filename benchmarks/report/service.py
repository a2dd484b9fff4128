"""The service: under load, attacked, and killed at random."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from benchmarks.report.plots import COLOURS
from benchmarks.report.section import MISSING, MOST_ROWS, Content, Page, several, table

Rows = Sequence[dict[str, Any]]
CHAOS = ("service/chaos-sqlite", "service/chaos-postgresql")
DECODE = "GET /decode/ID.png"


def page(contents: Mapping[str, Content]) -> Page:
    """The page from service/*.json, as far as there are."""
    names = ("service/load", "service/attacks")
    load, attacks = ([*contents[name]["rows"]] if name in contents else [] for name in names)
    attacks.sort(key=lambda row: -row["others_worst_p99_ms"])
    allowed = contents["service/attacks"]["settings"]["at_most"] if attacks else {}
    ledgers = [contents[name]["rows"][0] for name in CHAOS if name in contents]
    return Page(
        name="service",
        title="The service",
        question="How fast does the service respond while it encodes, how much do attacks slow other clients down, and "
        "are jobs lost when processes are killed? Half of all requests are answered within p50, 99 % within p99.",
        table=table("situation | request | p50 ms | p99 ms | failed | web process, MB", lines(load, attacks)),
        conclusion=f"{answering(load, attacks, allowed)} {surviving(ledgers)}",
        limits="- A network: clients, attackers and service share two cores of one machine.\n"
        "- Attacks from more machines or addresses than were tried, or of kinds that were not.\n"
        "- A disk that fails, or a machine that loses power, while processes are killed.",
        command="python -m benchmarks --full --only service",
        contents=contents,
        panels=[partial(draw, attacks=attacks, most_ms=allowed["p99_ms"])] if attacks else [],
        of="others' worst p99 under each attack",
    )


def lines(load: Rows, attacks: Rows) -> list[list[Any]]:
    """Rows for load, then for the attacks that others notice most."""
    found: list[list[Any]] = []
    for row in load:
        of = row["spreads"][DECODE]
        what = f"during an encode: {source(row)}, {row['rate']:g} a second"
        found.append([what, f"`{DECODE}`", f"{of['p50_ms']:,.0f}", f"{of['p99_ms']:,.0f}", of["failed"], MISSING])
    for row in attacks[: MOST_ROWS - len(found)]:
        asked, worst = max(row["others"].items(), key=lambda item: item[1]["p99_ms"])
        what = f"under attack: {row['words']}" + (f", {row['at_once']:,} at once" if row["at_once"] else "")
        times = f"{worst['p50_ms']:,.0f}", f"{worst['p99_ms']:,.0f}"
        found.append([what, f"`{asked}`", *times, row["others_failed"], f"{row['web_mb']['most']:.0f}"])
    return found


def answering(load: Rows, attacks: Rows, allowed: Mapping[str, float]) -> str:
    """Load and attacks against their limits, in a sentence."""
    parts = []
    if load:
        spreads = [(row, row["spreads"][DECODE]) for row in load]
        served = [(of["p99_ms"], row) for row, of in spreads if not of["failed"]]
        told = []
        if served:
            worst_ms, row = max(served, key=lambda item: item[0])
            told.append(f"99 % of {row['rate']:g} pictures a second {source(row)} are served within {worst_ms:.0f} ms")
        for row, of in spreads:
            if of["failed"]:
                share = f"{100 * of['failed'] / of['requests']:.0f} %"
                told.append(
                    f"{row['rate']:g} a second {source(row)} are too many here: half take {of['p50_ms']:.0f} ms or "
                    f"more, and {share} fail"
                )
        parts.append(f"During an encode, {'; '.join(told)}")
    if attacks:
        met = [row["met"] for row in attacks if row["attack"] != "none"]
        failed = sum(row["others_failed"] for row in attacks)
        worst = f"{attacks[0]['others_worst_p99_ms']:,.0f} ms (limit: {allowed['p99_ms']:,})"
        kept = f"all limits hold in {sum(met)} of {len(met)} attacks"
        parts.append(
            f"Under attack, others' p99 is at most {worst}, {failed or 'none'} of their requests fail, and {kept}"
        )
    return ". ".join(parts) + "."


def source(row: Mapping[str, Any]) -> str:
    """Where the pictures of a load come from."""
    return str(row["case"].partition(",")[0])


def surviving(ledgers: Rows) -> str:
    """What the ledgers say, in a sentence."""
    if not ledgers:
        return "Kills were not measured."
    counts = ("accepted", "lost", "published twice")
    jobs, lost, twice = (sum(row["ledger"][name] for row in ledgers) for name in counts)
    kills = sum(count for row in ledgers for name, count in row["happened"].items() if "killed" in name)
    where = several([{"sqlite": "SQLite", "postgresql": "PostgreSQL"}[row["database"]] for row in ledgers])
    crashed = sum(row["ledger"].get("failed because crashed", 0) for row in ledgers)
    ends = f"{lost or 'none'} were lost, {twice or 'none'} published twice, and {crashed or 'none'} failed as crashed"
    return f"Of {jobs:,} jobs during {kills} kills, on {where}, {ends}."


def draw(axes: Any, attacks: Rows, most_ms: float) -> None:
    """A bar for each attack, the worst at the top."""
    names = [row["words"] for row in reversed(attacks)]
    axes.barh(names, [row["others_worst_p99_ms"] for row in reversed(attacks)], color=COLOURS[1])
    axes.axvline(most_ms, color=COLOURS[2], linestyle="--", label="limit")
    axes.set(xscale="log", xlabel="milliseconds")
    axes.tick_params(axis="y", labelsize=7)
