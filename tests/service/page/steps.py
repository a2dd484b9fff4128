"""What the page shows first, and what it cannot read."""

from __future__ import annotations

import sgmethod
from tests.support.data import EXAMPLES, STATIC, golden

OTHER = golden()[EXAMPLES[0]]  # which the page does not read
COFFEE, PHOTOGRAPH = ((STATIC / "samples" / f"coffee.{kind}").read_bytes() for kind in ("sg", "webp"))
COFFEE_SAYS = f"{sgmethod.info(COFFEE).gaussians:,} Gaussians"
