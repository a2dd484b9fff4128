"""Sparse pictures: the fit sees only their islands, if these are much smaller than the level that it would need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sgmethod.fitting.level import Pyramid, target_of
from sgmethod.rd.request import Request

LARGE = 1 << 18  # pixels of a picture; a smaller one is fitted in no time
SMALLER = 4  # times: a sheet's fit also takes time for moving Gaussians to it


def on_islands(request: Request) -> tuple[Request, Pyramid]:
    """Return a request and the pyramid of its picture or, if it is sparse, of the sheet of its islands.

    With alpha, colours are all the same to hidden pixels, and seldom one colour.
    """
    whole = request.whole()
    pyramid = request.pyramid(whole)
    islands = request.islands() if whole.pixels >= LARGE else None
    if islands is None or SMALLER * islands.pixels > pyramid.finest.pixels or request.objective.shown is not None:
        return request, pyramid
    colour = np.array([[request.histogram.background]], np.uint8)
    sheet = whole.on_sheet(islands, target_of(colour, request.background))
    return replace(request, backend=sheet.backend), request.pyramid(sheet)
