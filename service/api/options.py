"""The options of an encode: one model for the form, the query and the OpenAPI document.

Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the image. The encoder
refuses them too, but it loads libraries that a web process does not need.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic.json_schema import SkipJsonSchema

from service.api.problems import ProblemError
from service.jobs.job import EncodeRequest, Priority, SourceImage
from sgmethod import profiles
from sgmethod.budget import BUDGET_KINDS, DEFAULT_BUDGET, QUALITIES, Budget, bytes_value, default_budget
from sgmethod.metrics.visual import SMALLEST_SIDE


def _given(description: str, example: float, **extra: Any) -> Any:
    return Field(default=None, description=description, examples=[example], json_schema_extra=extra)


_positive = partial(_given, exclusiveMinimum=0)
QUALITY_SCHEMA = {
    "anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": 100}, {"type": "string", "enum": [*QUALITIES]}]
}
BYTES_SCHEMA = {
    "anyOf": [
        {"type": "number", "exclusiveMinimum": 0},
        {"type": "string", "pattern": r"^[0-9]+(\.[0-9]+)?([kKmM][bB]?|[kKmM][iI][bB])$"},
    ]
}
Number = float | SkipJsonSchema[None]


class EncodeOptions(BaseModel):
    """The options of an encode.

    Give at most one budget. The default is 0.3 bits per pixel, but at most 50,000 bytes.

    Raises ValidationError, BudgetError, or ProblemError 422.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    bpp: Number = _positive("budget: maximum bits per pixel", 0.3)
    bytes: Annotated[float | SkipJsonSchema[None], BeforeValidator(bytes_value), WithJsonSchema(BYTES_SCHEMA)] = _given(
        "budget: maximum bytes, such as 20000, 20k, 1.5MB or 20KiB", 20_000
    )
    quality: Annotated[
        float | SkipJsonSchema[None],
        BeforeValidator(lambda text: QUALITIES.get(text, text)),
        WithJsonSchema(QUALITY_SCHEMA),
    ] = _given("budget: target SSIMULACRA 2, up to 100, or preview (40), web (60), archive (80); profile rd only", 60)
    psnr: Number = _positive("budget: target PSNR in dB, at most 60", 32)
    gaussians: Number = _positive("budget: number of Gaussians", 1000)
    profile: Annotated[str, AfterValidator(profiles.checked_profile)] = Field(
        default=profiles.DEFAULT_PROFILE, json_schema_extra={"enum": list(profiles.PROFILE_NAMES)}
    )
    tune: str | SkipJsonSchema[None] = Field(
        default=None,
        description="visual looks best, fidelity is that without synthesised grain, psnr has the least squared error",
        json_schema_extra={"enum": list(profiles.TUNES)},
    )
    effort: int = Field(
        default=profiles.DEFAULT_EFFORT,
        ge=min(profiles.EFFORTS),
        le=max(profiles.EFFORTS),
        description=f"{min(profiles.EFFORTS)} is fastest, {max(profiles.EFFORTS)} gives the best file; profile rd only",
    )
    time_limit_s: Number = _positive("time limit in seconds (default: the longest that the service allows)", 60)
    priority: Priority = Field(default="interactive", description="interactive jobs run before bulk jobs")

    @model_validator(mode="after")
    def _one_budget(self) -> EncodeOptions:
        given = [kind for kind in BUDGET_KINDS if getattr(self, kind) is not None]
        if len(given) > 1:
            raise ProblemError(422, f"give one of {', '.join(BUDGET_KINDS)}; got {len(given)}")
        _ = self.budget
        return self

    @property
    def budget(self) -> Budget:
        """The budget given, or the default. Raises BudgetError."""
        budgets = ((kind, getattr(self, kind)) for kind in BUDGET_KINDS)
        return next((Budget(kind, value) for kind, value in budgets if value is not None), DEFAULT_BUDGET)

    def request(self, image: SourceImage, max_s: float) -> EncodeRequest:
        """Return the encoder's part of the request. max_s: the longest and default time limit in seconds.

        Raises BudgetError or ProblemError 422 if no file of the image could meet it.
        """
        seconds = max_s if self.time_limit_s is None else self.time_limit_s
        if not (math.isfinite(seconds) and 0 < seconds <= max_s):
            raise ProblemError(422, f"time_limit_s must be more than 0 and at most {max_s:g}")
        budget, profile = self.budget, profiles.checked_profile(self.profile)
        tune = profiles.tuning(self.tune, profile, budget)
        settings = profiles.settings_of(profile, self.effort)
        if not all(map(find_spec, profiles.method_of(profile).packages)):
            raise ProblemError(422, f"profile {profile} needs PyTorch, which this service lacks; use profile rd")
        profiles.check_kind(budget, profile)
        if budget.kind == "quality" and min(image.width, image.height) < SMALLEST_SIDE:
            raise ProblemError(422, f"quality is undefined for sides below {SMALLEST_SIDE} pixels")
        if budget.kind == "gaussians":
            budget.max_gaussians(image.width, image.height)  # raises BudgetError
        if budget is DEFAULT_BUDGET:
            budget = default_budget(image.width, image.height, profiles.smallest_file(settings, has_alpha=True))
        allowed, min_bytes = budget.max_bytes(image.width, image.height), profiles.smallest_file(settings)
        if allowed is not None and allowed < min_bytes:
            detail = f"a file of profile {profile} takes at least {min_bytes} bytes, the budget is {allowed}"
            raise ProblemError(422, detail)
        return EncodeRequest(budget.kind, budget.value, profile, seconds, tune, self.effort)


OPTIONS = tuple(EncodeOptions.model_fields)
OPTION_SCHEMAS: dict[str, dict[str, Any]] = {
    name: {word: value for word, value in schema.items() if word != "title" and value is not None}
    for name, schema in EncodeOptions.model_json_schema()["properties"].items()
}


def read_options(fields: Iterable[tuple[str, str]]) -> EncodeOptions:
    """Parse the options among the fields of the query and of a form. Raises ProblemError 422, BudgetError."""
    texts: dict[str, str] = {}
    for name, value in fields:
        if name in texts:
            raise ProblemError(422, f"the field {name} is given twice")
        texts[name] = value
    try:
        return EncodeOptions.model_validate(texts)
    except ValidationError as error:
        fault = error.errors()[0]
        field = fault["loc"][0]
        if fault["type"] == "extra_forbidden":
            raise ProblemError(422, f"unknown field {field!r}; the options are {', '.join(OPTIONS)}") from error
        raise ProblemError(422, f"{field}: {fault['msg']}") from error
