"""Settings of profiles paper and baseline."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sgmethod.settings.shared import ADAM, STRUCTURE, OptimiserSettings, StartSettings


@dataclass(frozen=True)
class PaperSettings:
    """Hyper-parameters of profiles paper and baseline."""

    start: StartSettings = STRUCTURE
    optimiser: OptimiserSettings = ADAM
    color_solve_steps: int = 10  # conjugate-gradient steps for the start's colours

    # Losses (sections III-D and III-E)
    lambda_g: float = 0.06  # geometry-consistent regularisation, section IV-A
    # Bitwidth loss, used if no byte budget sets the bitwidths: a tenth of the number in section IV-A, which on the
    # scale of our error leaves nearly all Gaussians at six bits.
    lambda_b: float = 0.00012
    lambda_r: float = 1.0  # commitment of colours to the codebooks (GSImage)
    # Ours: penalty in the fit on the energy of each Gaussian alone, because large colours that cancel do not survive
    # six bits each. 28.9 -> 29.3 dB and 28.4 -> 28.8 dB on two photographs after quantisation.
    lambda_e: float = 0.003

    # Schedule: ours.
    fit_steps: int = 4000
    tune_steps: int = 2500
    tune_rate: float = 0.5  # factor on the optimiser's rates
    bits_rate: float = 0.02
    # A range starts at these quantiles of its values: one outlier would coarsen all (28.6 -> 28.9 dB).
    range_quantile: float = 0.01
    range_rate: float = 1e-4  # in multiples of the range's width
    patience: float = 0.3  # a phase has converged after this part of the schedule without progress

    # Quantisation (sections III-C and IV-A)
    position_bits: int = 12
    adaptive_bitwidth: bool = True  # False: uniform at min_bitwidth (GSImage)
    min_bitwidth: int = 6
    max_bitwidth: int = 16
    mean_bitwidth: float = 7.5  # aimed at when a byte budget fixes the number of Gaussians
    codebook_decay: float = 0.8  # GSImage

    @property
    def most_groups(self) -> int:
        """Number of bitwidths that a file may have."""
        return self.max_bitwidth - self.min_bitwidth + 1 if self.adaptive_bitwidth else 1


PAPER = PaperSettings()
BASELINE = replace(
    PAPER,
    start=replace(STRUCTURE, structure_guided=False),
    lambda_g=0.0,
    position_bits=16,
    adaptive_bitwidth=False,
    mean_bitwidth=6.0,
)
