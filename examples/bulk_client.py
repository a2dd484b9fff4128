"""Encode a folder through a service: python bulk_client.py http://127.0.0.1:8000 PHOTOS OUT

If it is stopped and run again, it continues where it was; jobs that the service has accepted are not submitted twice.
If the service has API keys, set SG_API_KEY to one.
"""

import os
import sys
from pathlib import Path

from sgmethod import Budget
from sgmethod.client import Client, encode_many


def encode_folder(url: str, photos: Path, out: Path) -> None:
    """Write an .sg file of each photograph in a folder, and out/manifest.jsonl."""
    with Client(url, api_key=os.environ.get("SG_API_KEY")) as client:
        tally = encode_many(
            client, sorted(photos.iterdir()), out, budget=Budget("bpp", 0.25), jobs=8, resume=True, on_row=report
        )
    print(f"{tally.encoded} encoded, {tally.skipped} there already, {tally.failed} failed")


def report(row, tally) -> None:
    left = "" if tally.seconds_left is None else f", {tally.seconds_left:.0f} s left"
    print(f"{row.name} {row.error or f'{row.bytes:,} bytes'}{left}")


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: python bulk_client.py URL PHOTOS OUT")
    encode_folder(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
