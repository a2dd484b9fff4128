"""The form of all results: command, origin (machine, commit, date), settings and rows."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from sgmethod.backend.protocol import release_memory
from sgmethod.io.files import write_atomically
from sgmethod.native import native

ROOT = Path(__file__).parents[1]  # of the repository
ISA_NAMES = ("x86-64", "AVX2", "AVX-512")
RESULTS = ROOT / "benchmarks" / "results"  # what the documents show
RUNS = ROOT / "build" / "bench"  # where the JSON of a run goes without --out
PACKAGES = ("numpy", "pillow", "torch", "imagecodecs")
UNKNOWN = "unknown"  # the commit where git knows none
# What measures: not its results, the pages made of them, the list of what to measure, and what browsers get.
NOT_CODE = (
    "benchmarks/results benchmarks/report benchmarks/__main__.py service/page sgmethod/javascript"
    " tests/support/browser.py tests/support/node.py"
)
CODE = ("sgmethod", "service", "benchmarks", "tests/support", *(f":!{path}" for path in NOT_CODE.split()))


def origin() -> dict[str, object]:
    """Commit, date (UTC) and machine, in plain JSON types."""
    return {
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)),
            "instruction_set": ISA_NAMES[native.best_isa()],
            "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            "python": platform.python_version(),
            "packages": {name: _version(name) for name in PACKAGES},
        },
    }


def commit() -> str:
    """The commit checked out, with a digest of the uncommitted changes to the measuring code, if there are any."""
    head = _git("rev-parse", "--short=12", "HEAD").strip()
    if not head:
        return UNKNOWN
    added = _git("ls-files", "--others", "--exclude-standard", "--", *CODE).splitlines()
    texts = [f"{name}\n{(ROOT / name).read_text(errors='replace')}" for name in added]
    difference = "".join([_git("diff", "HEAD", "--", *CODE), *texts])
    if not difference:
        return head
    return f"{head}+{hashlib.sha256(difference.encode()).hexdigest()[:8]}"


def same_code(one: str, other: str) -> bool:
    """Whether two names from commit() stand for the same measuring code. Other files may have changed between them."""
    if one == other:
        return one != UNKNOWN
    are_commits = all(_git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}") for name in (one, other))
    return are_commits and not _git("diff", one, other, "--", *CODE)


def kept_rows(path: Path, where: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows of an earlier run, if its code, machine, number of threads and settings were the same."""
    if not path.exists():
        return []
    content = json.loads(path.read_text())
    same = all(content.get(name) == where[name] for name in ("machine", "settings") if name in where)
    same = same and threads_of(content) == threads_of(where)
    return rows_of(content) if same and same_code(content["commit"], where["commit"]) else []


def threads_of(content: Mapping[str, Any]) -> int | None:
    """The number of threads that a JSON's command sets; None for one for each core."""
    threads = re.match(r"SG_THREADS=(\d+) ", content.get("command", ""))
    return int(threads[1]) if threads else None


def found(key: dict[str, Any], rows: Iterable[dict[str, Any]]) -> dict[str, Any] | None:
    """The first row with these values."""
    return next((row for row in rows if all(row.get(name) == value for name, value in key.items())), None)


class Record:
    """The JSON of one run, written after every row. Rows of an earlier run with the same code, machine and settings are
    kept, so that an interrupted run continues where it stopped; a JSON without such rows becomes NAME.json.before.
    Prints the path of the JSON first.

    settings: what changes the meaning of the rows.
    """

    def __init__(self, path: Path, module: str, settings: dict[str, Any]) -> None:
        self.path = path
        self.content = {"command": command(module), **origin(), "settings": settings}
        self.rows = kept_rows(path, self.content)
        if self.rows:  # several commands may fill one JSON
            commands = [*json.loads(path.read_text())["command"].split(" + "), self.content["command"]]
            self.content["command"] = " + ".join(dict.fromkeys(commands))
        elif path.exists():  # it may have taken hours
            path.replace(path.with_name(f"{path.name}.before"))
        print(f"into {path}, which has {len(self.rows)} rows of this code, machine and settings", file=sys.stderr)

    def has(self, **key: object) -> bool:
        """Whether there is a row with these values."""
        return found(key, self.rows) is not None

    def add(self, row: dict[str, Any]) -> None:
        """Add a row to the JSON, and print it."""
        self.rows.append(row)
        write_text(self.path, one_a_line({**self.content, "rows": self.rows}))
        print(", ".join(f"{name} {_short(value)}" for name, value in row.items() if value is not None), flush=True)


def command(module: str) -> str:
    """The command line without --out, after SG_THREADS if it is set. A path is replaced by its last part in capitals,
    because its place on this machine means nothing elsewhere."""
    words = [Path(word).name.upper() if "/" in word and not _is_result(word) else word for word in sys.argv[1:]]
    if "--out" in words:
        del words[words.index("--out") : words.index("--out") + 2]
    threads = os.environ.get("SG_THREADS")
    return (f"SG_THREADS={threads} " if threads else "") + shlex.join(["python", "-m", *module.split(), *words])


def _is_result(name: str) -> bool:
    return (RESULTS / f"{name}.json").exists()


def write_text(path: Path, text: str) -> None:
    """Write a file completely or not at all, so that an interrupted benchmark keeps the earlier results."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())


def one_a_line(content: Mapping[str, Any]) -> str:
    """JSON with each field on a line, and each column of "rows". Rows with the same names are a table; "at" is their
    places among all rows."""
    tables: dict[tuple[str, ...], dict[str, list[Any]]] = {}
    for at, row in enumerate(content["rows"]):
        table = tables.setdefault(tuple(row), {name: [] for name in ("at", *row)})
        for name, value in {"at": at, **row}.items():
            table[name].append(value)
    fields = {name: _lines(value) for name, value in content.items()}
    fields["rows"] = _lines([*tables.values()], columns=True)
    return "{\n" + ",\n".join(f"{json.dumps(name)}: {text}" for name, text in fields.items()) + "\n}\n"


def rows_of(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The rows of a JSON, in their order."""
    every = [dict(zip(table, of, strict=True)) for table in content["rows"] for of in zip(*table.values(), strict=True)]
    return [{name: row[name] for name in row if name != "at"} for row in sorted(every, key=lambda row: row["at"])]


def alone(function: Callable[..., dict[str, Any]], *arguments: object) -> dict[str, Any]:
    """Run a function in a process of its own, whose memory and settings are its own, and return its result."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def peak_bytes(process: int | str = "self") -> int:
    """The peak memory of a process. (getrusage would include the process that started it.)"""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


def forget_peak() -> int:
    """Let peak_bytes() of this process begin anew, at the memory in use now, and return that.

    First return freed memory to the system: otherwise a task reuses what an earlier one freed, and seems to need none.
    """
    release_memory()
    Path("/proc/self/clear_refs").write_text("5")
    return peak_bytes()


def _lines(value: Any, columns: bool = False) -> str:
    """A field. A list of records has each of them on a line, or each column of a record."""
    if isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
        return "[\n" + ",\n".join(_record(one, ",\n " if columns else ", ") for one in value) + "\n]"
    return json.dumps(value, allow_nan=False)


def _record(values: Mapping[str, Any], between: str) -> str:
    fields = [f"{json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in values.items()]
    return "{" + between.join(fields) + "}"


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{len(value)} values" if isinstance(value, list) else str(value)


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "unknown"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
