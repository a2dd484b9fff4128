"""Constants of the encoder in JavaScript that are ours: python -m tests.support.javascript_settings writes them."""

from __future__ import annotations

from sgmethod.backend.protocol import GRID_REACH
from sgmethod.native import native
from sgmethod.previews import preview, reducing, still
from sgmethod.settings.rd import RD
from tests.support.data import JAVASCRIPT

WRITTEN = JAVASCRIPT / "encoder" / "settings.js"
TIMES, ADAM, MOVING = RD.effort.times, RD.fit.optimiser, RD.objective.moving
CONSTANTS: dict[str, float | tuple[int, ...]] = {
    # fitting.js
    "SPARSE": RD.schedule.sparse,
    "DENSE": RD.schedule.dense,
    "RATE_WEIGHT": RD.fit.rate_weight,
    "BITS_PER_GAUSSIAN": RD.rate.bits_per_gaussian,
    "STEERING_FROM": TIMES.steering_from,
    "STEERING_LIMIT": RD.rate.steering_limit,
    "STEERING_EXPONENT": RD.rate.steering_exponent,
    "EXCESS": TIMES.excess,
    "EXCESS_FROM": TIMES.excess_from,
    "EXCESS_UNTIL": TIMES.excess_until,
    "FINER_EARLY": TIMES.finer_early,
    "BITS_OF_NEW": RD.densify.bits_of_new,
    "MIN_GROWN": RD.densify.fewest,
    "WORTHLESS_BITS": RD.prune.worthless_bits,
    "RATE": ADAM.mean_rate,
    "LAST_RATE": ADAM.final_rate,
    "BETA1": ADAM.beta1,
    "BETA2": ADAM.beta2,
    "NEWTON_STEPS": ADAM.newton_steps,
    "FAINT": round(native.FAINT**0.5, 6),
    "REACH": GRID_REACH,
    "REFINE_WEIGHT": RD.refine.weight,
    "MIN_USED": RD.rate.min_used,
    "QUANTUM_PER_SIZE": RD.rate.quantum_per_size,
    # targets.js
    "OVERSHOOT": MOVING.overshoot,
    "MARGIN": MOVING.margin,
    "OF_SLOPE": MOVING.of_slope,
    # encoder.js
    "COARSER_ALPHA": RD.alpha.coarser,
    "PIXELS_PER_BYTE": preview.PIXELS_PER_BYTE,
    "SOFT_PX": preview.SOFT_PX,
    "SOFT_BYTES": preview.SOFT_BYTES,
    "NARROWEST_PX": ADAM.min_scale_px,
    "DARK": preview.DARK,
    # reducing.js
    "THINNEST": reducing.THINNEST,
    "SHORTEST": reducing.SHORTEST,
    # uri.js
    "SIDES": still.SIDES,
    "JUDGED_SIDE": still.JUDGED_SIDE,
}


def text() -> str:
    """The module."""
    lines = (f"export const {name} = {_written(value)};\n" for name, value in CONSTANTS.items())
    return f"// Made by tests/support/javascript_settings.py from Python's, which say why.\n\n{''.join(lines)}"


def _written(value: float | tuple[int, ...]) -> str:
    return str([*value]) if isinstance(value, tuple) else f"{value:.15g}"


if __name__ == "__main__":
    WRITTEN.write_text(text())
