"""Constants of the encoder in JavaScript that are ours: python -m tests.support.javascript_settings writes them."""

from __future__ import annotations

from sgmethod.backend.protocol import GRID_REACH
from sgmethod.fitting import moving_target
from sgmethod.native import native
from sgmethod.previews import preview, reducing, still
from sgmethod.rd import byte_limit, densify, rate_control, schedule, search
from sgmethod.rd.fit import RATE_WEIGHT
from sgmethod.settings.rd import NEWTON_ADAM, RD
from tests.support.data import JAVASCRIPT

WRITTEN = JAVASCRIPT / "encoder" / "settings.js"
TIMES, ADAM = RD.effort.times, NEWTON_ADAM
CONSTANTS: dict[str, float | tuple[int, ...]] = {
    # fitting.js
    "SPARSE": schedule.SPARSE,
    "DENSE": schedule.DENSE,
    "RATE_WEIGHT": RATE_WEIGHT,
    "BITS_PER_GAUSSIAN": byte_limit.BITS_PER_GAUSSIAN,
    "STEERING_FROM": TIMES.steering_from,
    "STEERING_LIMIT": rate_control.STEERING_LIMIT,
    "STEERING_EXPONENT": rate_control.STEERING_EXPONENT,
    "EXCESS": TIMES.excess,
    "EXCESS_FROM": TIMES.excess_from,
    "EXCESS_UNTIL": TIMES.excess_until,
    "FINER_EARLY": TIMES.finer_early,
    "BITS_OF_NEW": densify.BITS_OF_NEW,
    "MIN_GROWN": densify.FEWEST,
    "WORTHLESS_BITS": densify.WORTHLESS_BITS,
    "RATE": ADAM.mean_rate,
    "LAST_RATE": ADAM.final_rate,
    "BETA1": ADAM.beta1,
    "BETA2": ADAM.beta2,
    "NEWTON_STEPS": ADAM.newton_steps,
    "FAINT": round(native.FAINT**0.5, 6),
    "REACH": GRID_REACH,
    "REFINE_WEIGHT": search.WEIGHT,
    "MIN_USED": byte_limit.MIN_USED,
    "QUANTUM_PER_SIZE": byte_limit.QUANTUM_PER_SIZE,
    # targets.js
    "OVERSHOOT": moving_target.OVERSHOOT,
    "MARGIN": moving_target.MARGIN,
    "OF_SLOPE": moving_target.OF_SLOPE,
    # encoder.js
    "COARSER_ALPHA": rate_control.COARSER_ALPHA,
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
