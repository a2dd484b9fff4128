"""Encode a folder of photographs on a cluster of Ray: python data_set_on_ray.py PHOTOS OUT

All nodes need sgmethod, and a file system they share, with PHOTOS and OUT at the same place. A shard of pictures
is a task of one core, with a folder in OUT and the manifest of encode_many(). If a node is lost, Ray starts its tasks
again on others, where they continue after the last file that is there. So does the whole, when you run it again.
RAY_ADDRESS names the cluster; without it, Ray takes the cores of this machine.
"""

import sys
from pathlib import Path

from sgmethod import encode_many, set_threads

SHARD = 100  # photographs


def encoded(photos: list[Path], folder: Path) -> tuple[int, int, int]:
    """Encode one shard, on any node."""
    set_threads(1)
    tally = encode_many(photos, folder, bytes=20_000, resume=True)
    return tally.encoded, tally.skipped, tally.failed


def encode_folder(photos: Path, out: Path) -> None:
    """Encode all shards, and print what has become of them."""
    import ray

    ray.init(log_to_driver=False)
    task = ray.remote(num_cpus=1, max_retries=-1)(encoded)
    paths = sorted(photos.resolve().iterdir())
    shards = [paths[first : first + SHARD] for first in range(0, len(paths), SHARD)]
    waiting = [task.remote(shard, out.resolve() / f"{number:06}") for number, shard in enumerate(shards)]
    done = [0, 0, 0]
    while waiting:
        finished, waiting = ray.wait(waiting)
        done = [sum(counts) for counts in zip(done, *ray.get(finished), strict=True)]
        print("{} encoded, {} there already, {} failed".format(*done), f"{len(waiting)} shards left", sep=", ")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python data_set_on_ray.py PHOTOS OUT")
    encode_folder(Path(sys.argv[1]), Path(sys.argv[2]))
