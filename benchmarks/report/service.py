"""The service: under load, attacked, killed at random, and for a long time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.report.plots import style
from benchmarks.report.section import Content, Draw, Section, table
from benchmarks.soak.samples import STEADY, median

# What a panel shows of the soak, by what its axis says.
PLOTTED = {
    "MB of memory": {"web_mb": "web process", "worker_mb": "worker"},
    "number kept": {"jobs": "jobs", "images": "images"},
}


def verdict(met: bool) -> str:
    """In a word."""
    return "met" if met else "missed"


def elsewhere(rows: Sequence[dict[str, Any]]) -> str:
    """How much of the machine was not the service's, nor its clients'."""
    cores = [row["cores_elsewhere"] for row in rows]
    return f"Other processes took {min(cores):.1f} to {max(cores):.1f} cores of the machine meanwhile."


def under_load(content: Content) -> Section:
    """From load.json."""
    settings, rows = content["settings"], content["rows"]
    limits = "; ".join(
        f"`{request}` {' and '.join(f'{name[:3]} {most:g} ms' for name, most in most_ms.items())}"
        for request, most_ms in settings["at_most_ms"].items()
    )
    said = (
        f"How fast does the service answer while it encodes? At most {limits}, which {sum(row['met'] for row in rows)} "
        f"of {len(rows)} cases meet. Client and service share the cores, which no network does."
    )
    how = (
        f"a picture of {settings['size'][0]}x{settings['size'][1]} ({rows[0]['bpp']:.3f} bpp, "
        f"{rows[0]['gaussians']:,} Gaussians, a PNG of {rows[0]['png_bytes']:,} bytes) is asked for at fixed moments "
        f"for {settings['seconds']:g} s, beside 20 requests a second of `/livez` and an encode of 3072x2048 that takes "
        f"every core it gets; a latency counts from the moment the request was due. {elsewhere(rows)}"
    )
    lines = [
        [
            row["case"],
            f"{row['rate']:g}",
            request,
            *(found[k] for k in ("requests", "failed", "p50_ms", "p99_ms", "most_ms")),
            verdict(row["met"]),
        ]
        for row in rows
        for request, found in row["spreads"].items()
    ]
    titles = "picture | a second | request | requests | failed | p50 ms | p99 ms | longest ms | case"
    return Section("load", "The service under load", said, [table(titles, lines)], [content], how=how)


def attacked(content: Content) -> Section:
    """From attacks.json."""
    settings, rows = content["settings"], content["rows"]
    most = settings["at_most"]
    said = (
        f"What do others notice while some mean harm? At most a p99 of {most['p99_ms']:,} ms for each thing that they "
        f"ask for, none of it failed, and {most['web_mb']} MB of the web process, which "
        f"{sum(row['met'] for row in rows)} of {len(rows)} rows meet. Attackers run on the same machine with the "
        "least priority: more of them, from more addresses, are not tried."
    )
    how = (
        f"each attack lasts {settings['seconds']:g} s and meets a fresh web process with default settings and no API "
        "keys. Attackers ask again as soon as they are answered; somebody else, from another address, asks for seven "
        f"things 37 times a second in all. {elsewhere(rows)}"
    )
    lines = [
        [
            row["words"],
            row["at_once"] or "-",
            _answers(row["answers"]),
            row["others_failed"],
            f"{row['others_worst_p99_ms']:,.0f}",
            ", ".join(f"{row['web_mb'][when]:.0f}" for when in ("start", "most", "after")),
            verdict(row["met"]),
        ]
        for row in rows
    ]
    titles = "attack | at once | how attackers were answered | others' requests that failed | worst p99 of others, ms"
    titles += " | web process: before, most, after, MB | verdict"
    requests = list(rows[0]["others"])
    slow = [[row["words"], *(row["others"][request]["p99_ms"] for request in requests)] for row in rows]
    by_request = "p99 in ms of others' requests:\n\n" + table(" | ".join(["attack", *requests]), slow)
    return Section("attacks", "The service attacked", said, [table(titles, lines), by_request], [content], how=how)


def _answers(answers: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {word}" for word, count in answers.items()) or "-"


def killed(*measured: Content | None) -> Section:
    """From chaos-sqlite.json and chaos-postgresql.json, as far as there are."""
    contents = [content for content in measured if content]
    rows = [content["rows"][0] for content in contents]
    balanced = [row["database"] for row in rows if row["balanced"]]
    said = (
        "Is a job lost, or done twice, when processes are killed, stopped and restarted at random, and jobs cancelled? "
        f"The ledger balances on {' and '.join(balanced) or 'none'}: every accepted job is done, has failed or was "
        "cancelled, and nothing else is left. Pictures are tiny, so that most of the time goes to processes that come "
        "and go. The disk itself never fails here, nor the whole machine."
    )
    names = list(dict.fromkeys(name for row in rows for name in row["ledger"]))
    events = list(dict.fromkeys(name for row in rows for name in row["happened"]))
    ledger = table(
        " | ".join(["jobs", *(r["database"] for r in rows)]), [_across(rows, "ledger", name) for name in names]
    )
    happened = [_across(rows, "happened", name) for name in events]
    happened.append(["submission asked again", *(f"{row['asked_again']:,}" for row in rows)])
    times = table(" | ".join(["what happened meanwhile, times", *(row["database"] for row in rows)]), happened)
    return Section("chaos", "The service killed at random", said, [ledger, times], contents)


def _across(rows: Sequence[dict[str, Any]], part: str, name: str) -> list[object]:
    return [name, *(row[part].get(name, 0) for row in rows)]


def soaked(content: Content) -> Section:
    """From soak.json."""
    settings, rows, rest = content["settings"], content["rows"], content["at_the_end"]
    third = len(rows) // 3
    parts = rows[:third], rows[third : 2 * third], rows[2 * third :]
    claims = content["claims"]
    broken = [claim for claim, holds in claims.items() if not holds]
    requests = sum(content["answers"].values())
    said = (
        f"Does anything grow? {settings['minutes']:g} minutes of work of every kind ({requests:,} requests: pictures "
        "of 0.05 to 12 megapixels encoded, encoded again and removed, pictures, files and parts taken, streams left "
        "early, damaged and hostile files, requests cut short), with jobs kept for "
        f"{settings['retention_s']:g} s and their images for {settings['image_retention_s']:g} s; after it nobody "
        f"asked for anything until these times were over. {len(claims) - len(broken)} of {len(claims)} claims hold"
        f"{': not ' + ', '.join(broken) if broken else ''}. A growth slower than a tenth in "
        f"{settings['minutes'] / 3:.0f} minutes is not seen."
    )
    names = [*STEADY, "jobs", "trace_points", "images", "bitstreams", "table_kb", "oldest_job_s", "oldest_image_s"]
    lines = [
        [
            name.replace("_", " "),
            *(f"{median(name, part):g}" for part in parts),
            f"{max(row[name] for row in rows):g}",
            f"{rest[name]:g}",
        ]
        for name in names
    ]
    titles = "what | median of the first third | of the second | of the last | most | at the end"
    kept = table("claim | holds", [[claim, "yes" if holds else "no"] for claim, holds in claims.items()])
    tables = [table(titles, lines), kept]
    panels: list[Draw] = [lambda axes, says=says: draw(axes, rows, says) for says in PLOTTED]  # type: ignore[misc]
    return Section("soak", "The service for a long time", said, tables, [content], panels)


def image(content: Content) -> Section:
    """From image.json."""
    rows = content["rows"]
    said = (
        "Does the Dockerfile build, and does what it builds run? Yes, as far as was tried: its own steps were done one "
        f"after the other in an empty Debian, as there was no container engine: {_build_args(content)}. Then web "
        "process and worker of compose.yaml ran there, with its commands, environment, user and volume, and without "
        "capabilities. The base image itself, layers and an engine's network were not tried."
    )
    lines = [[row["step"].replace("|", "\\|"), f"{row['seconds']:.1f}", _more(row)] for row in rows]
    tables = [table("step | seconds | what came of it", lines)]
    return Section("image", "The image without an engine", said, tables, [content])


def _build_args(content: Content) -> str:
    return ", ".join(f"{name} is {value}" for name, value in content["settings"]["build_args"].items()) or "as it is"


def _more(row: dict[str, Any]) -> str:
    told = {name: value for name, value in row.items() if name not in ("step", "seconds")}
    parts = [f"{name.replace('_', ' ')}: {'; '.join(v) if isinstance(v, list) else v}" for name, v in told.items()]
    return ", ".join(parts) or "-"


def draw(axes: Any, rows: Sequence[dict[str, Any]], says: str) -> None:
    """What there was of each, over the minutes."""
    minutes = [row["minutes"] for row in rows]
    before = [name for panel in PLOTTED.values() for name in panel]
    for name, words in PLOTTED[says].items():
        how = style(before.index(name)) | {"marker": ""}
        axes.plot(minutes, [row[name] for row in rows], **how, label=words)
    axes.set(xlabel="minutes", ylabel=says)
    axes.set_ylim(bottom=0)
