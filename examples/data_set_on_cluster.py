"""Encode a folder of photographs on a cluster: python data_set_on_cluster.py PHOTOS OUT dask|ray ADDRESS

ADDRESS is that of Dask's scheduler, such as tcp://10.0.0.1:8786, or of Ray, such as 10.0.0.1:6379. All nodes need
sgmethod, and PHOTOS at the same place. If a node is lost, others encode its photographs. If this program is, run it
again: it skips what is done. OUT and its manifest are written here alone.
"""

import sys
from concurrent.futures import Executor, Future
from functools import cache
from pathlib import Path
from typing import Any

from sgmethod import Row, Tally, encode_many


def dask_executor(address: str) -> Executor:
    """Return the executor of a cluster of Dask. Its workers take SG_THREADS from where they are started."""
    from distributed import Client

    return Client(address).get_executor()


class RayExecutor(Executor):
    """Tasks of Ray, one for each core."""

    def __init__(self, address: str) -> None:
        import ray

        ray.init(address, log_to_driver=False, runtime_env={"env_vars": {"SG_THREADS": "1"}})
        self._remote = cache(ray.remote(num_cpus=1, max_retries=3))  # a function is sent to the nodes once

    def submit(self, function: Any, /, *arguments: Any, **named: Any) -> Future[Any]:
        """Begin a task, which Ray begins again if its node is lost. A fourth loss, as by full memory, ends the run."""
        return self._remote(function).remote(*arguments, **named).future()


def show(row: Row, tally: Tally) -> None:
    """Print what has become of a photograph."""
    print(f"{row.name}: {row.error or row.bytes} ({tally.encoded} encoded, {tally.failed} failed)", flush=True)


if __name__ == "__main__":
    kinds = {"dask": dask_executor, "ray": RayExecutor}
    if len(sys.argv) != 5 or sys.argv[3] not in kinds:
        sys.exit("usage: python data_set_on_cluster.py PHOTOS OUT dask|ray ADDRESS")
    executor = kinds[sys.argv[3]](sys.argv[4])
    photos = sorted(Path(sys.argv[1]).iterdir())
    tally = encode_many(photos, sys.argv[2], executor=executor, resume=True, on_row=show, bytes=20_000)
    print(f"{tally.encoded} encoded, {tally.skipped} there already, {tally.failed} failed")
