"""Encode a folder by a service: python bulk_client.py http://127.0.0.1:8000 PHOTOS OUT

Killed and run again, it goes on where it was: jobs that the service has taken are not submitted twice. A service with
API keys wants one in SG_API_KEY.
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
