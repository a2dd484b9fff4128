"""The quantiser of profile rd as the fit sees it: steps from sensitivity, and the rate.

The integers and the exact rounding live in native code (sgmethod/native/rd/symbols.h), where also the derivation of
the steps stands. All of them follow from the size s = sqrt(l1 l3), the quantum q and m, the length of the colour in
its steps of q / (1.5 s):

    u = log s: 0.707 / m    v = log(l1 / l3) / 2: 1 / m    r = l2 / l3: 2 / m    mean in units of L: 1.414 / m

Every parameter then costs the picture the same: q^2 / 12 of squared error on average.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from sgmethod.bitstream.payload import background_of, is_upright, quantum_code, quantum_of
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.fitting.eye import Visibility
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.picture import Target
from sgmethod.native import native


def error_per_bit(quantum: float) -> float:
    """What one bit buys at the margin, in squared error summed over the picture: of a uniform quantiser's error
    q^2 / 12 a further bit takes away 3/4, that is -d(q^2 / 12)/d(bits) = q^2 ln(2) / 6."""
    return quantum**2 * math.log(2) / 6


def add_rate_gradient(p: Parameters, grad: Parameters, quantum: float, weight: float) -> None:
    """Add the gradient of weight * sum of a smooth estimate of each Gaussian's bits, up to a constant.

    That is log2(1 + |value| / step) of every coded value, and log2(1 + m) for u and both coordinates, whose range
    does not depend on their value.
    """
    values = (p.factors, p.colors, grad.factors, grad.colors)
    native.rd_rate_gradient(quantum, weight, *(t.numpy() for t in values))


def energies(p: Parameters) -> Tensor:
    """Squared error [N] that each Gaussian alone would leave if it were dropped."""
    return math.pi * p.factors[:, 0] * p.factors[:, 2] * p.colors.square().sum(1)


class Coder:
    """Exact rounding and exact sizes for one picture and quantum."""

    def __init__(
        self,
        size: tuple[int, int],
        quantum: float,
        background: tuple[int, int, int],
        grey: bool,
        with_shear: bool = False,
    ) -> None:
        """with_shear: shear is coded even where no Gaussian has any."""
        self.size, self.background, self.grey, self.with_shear = size, background, grey, with_shear
        self.quantum = quantum_of(quantum_code(quantum))
        self._parameters = native.RdParameters(*size, self.quantum, grey)

    @classmethod
    def of(cls, pixels: NDArray[np.uint8], quantum: float, with_shear: bool = False) -> Coder:
        """For a picture [H, W, 3], with its background."""
        background = background_of(pixels)
        grey = len(set(background)) == 1 and bool((pixels == pixels[:, :, :1]).all())
        return cls((pixels.shape[1], pixels.shape[0]), quantum, background, grey, with_shear)

    def with_quantum(self, quantum: float) -> Coder:
        """The same with another quantum."""
        return Coder(self.size, quantum, self.background, self.grey, self.with_shear)

    def rounded(self, p: Parameters) -> Parameters:
        """What the decoder will see; colour 0 where nothing of a Gaussian is left."""
        out = Parameters.empty(len(p.means))
        native.rd_quantise(self._parameters, *p.arrays(), *out.arrays())
        return out

    def stream(self, p: Parameters) -> StreamV4:
        """The coded picture."""
        return StreamV4.of(p.numpy(), self.size, self.quantum, self.background, self.grey, self.with_shear)

    def refined(
        self,
        p: Parameters,
        target: Target,
        price: float,
        sweeps: int,
        seconds: float,
        max_payload: int,
        visibility: Visibility | None = None,
    ) -> StreamV4:
        """The coded picture, with integers changed one Gaussian at a time where that lowers squared error plus price
        times bits; then without those that gain least for their bits, until the payload has at most max_payload bytes.

        target: of the picture; price: squared error summed over the picture, as it is seen if there is a visibility;
        sweeps over all Gaussians, at most, and no longer than seconds.
        """
        upright = is_upright(p.factors.numpy(), self.with_shear)
        parameters = native.RdParameters(*self.size, self.quantum, self.grey, upright)
        arrays = *p.arrays(), target
        limits = price, sweeps, seconds, max_payload
        seen = () if visibility is None else (visibility.values, visibility.by_eye)
        payload = native.rd_refine(parameters, *arrays, native.CUTOFF_V3, *limits, *seen)
        return StreamV4(*self.size, self.quantum, self.background, self.grey, upright, payload)
