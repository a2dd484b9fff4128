"""What an encode is asked for beside its image: one model for the form, the query and the OpenAPI document.

Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the picture. The encoder
refuses them too; it cannot be asked here, since it loads libraries that a web process does without.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator
from pydantic.json_schema import SkipJsonSchema
from starlette.datastructures import UploadFile

from service.api.problems import ProblemError
from service.jobs.job import PRIORITIES, EncodeRequest, Priority, SourceImage
from sgmethod.bitstream.smallest import smallest_file
from sgmethod.budget import BUDGET_KINDS, DEFAULT_BUDGET, LOOKS, Budget, default_budget
from sgmethod.errors import BudgetError
from sgmethod.metrics.looks import SMALLEST_SIDE
from sgmethod.profiles import (
    DEFAULT_EFFORT,
    DEFAULT_PROFILE,
    EFFORTS,
    PROFILE_NAMES,
    PROFILES,
    TUNES,
    checked_effort,
    settings_of,
    tuning,
)
from sgmethod.settings.rd import RdSettings

IMAGE_FIELD = "image"  # of the form, and none of the model
CHOICES: dict[str, Sequence[str]] = {"profile": PROFILE_NAMES, "priority": PRIORITIES}
# Stricter than float(), which also takes "1_0", "nan" and spaces around.
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")


def _number(text: str, info: ValidationInfo) -> float:
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(f"{info.field_name} must be a number, got {text!r}")
    return float(text)


def _looks(text: str, info: ValidationInfo) -> float:
    return LOOKS[text] if text in LOOKS else _number(text, info)


def _choice(text: str, info: ValidationInfo) -> str:
    name = info.field_name or ""
    if text not in CHOICES[name]:
        raise ValueError(f"unknown {name} {text!r}; use one of {', '.join(CHOICES[name])}")
    return text


def _effort(text: str, info: ValidationInfo) -> int:
    number = _number(text, info)
    try:
        return checked_effort(int(number) if number.is_integer() else number)
    except BudgetError as error:
        raise ValueError(str(error)) from error


def _positive(description: str, example: float) -> Any:
    extra: dict[str, Any] = {"exclusiveMinimum": 0}
    return Field(default=None, description=description, examples=[example], json_schema_extra=extra)


Number = Annotated[float | SkipJsonSchema[None], BeforeValidator(_number)]


@dataclass(frozen=True)
class CheckedOptions:
    """What a client asks for, checked and complete. has_budget: a budget was given, and not the default taken."""

    request: EncodeRequest
    priority: Priority
    has_budget: bool = True


class EncodeOptions(BaseModel):
    """The options. Give at most one budget; the default is 0.3 bits per pixel."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    bpp: Number = _positive("budget: maximum bits per pixel", 0.3)
    bytes: Number = _positive("budget: maximum bytes", 20_000)
    looks: Annotated[float | SkipJsonSchema[None], BeforeValidator(_looks)] = _positive(
        "budget: target SSIMULACRA 2, up to 100, or preview (40), web (60), archive (80); profile rd only", 60
    )
    psnr: Number = _positive("budget: target PSNR in dB, at most 60", 32)
    quality: Number = _positive("budget: round everything this finely, above 0 and up to 100; profile rd only", 50)
    gaussians: Number = _positive("budget: number of Gaussians", 1000)
    profile: Annotated[str, BeforeValidator(_choice)] = Field(
        default=DEFAULT_PROFILE, json_schema_extra={"enum": list(PROFILE_NAMES)}
    )
    tune: str | SkipJsonSchema[None] = Field(
        default=None, description="optimise for PSNR or for the eye", json_schema_extra={"enum": list(TUNES)}
    )
    effort: Annotated[int, BeforeValidator(_effort)] = Field(
        default=DEFAULT_EFFORT,
        ge=min(EFFORTS),
        le=max(EFFORTS),
        description=f"{min(EFFORTS)} is fastest, {max(EFFORTS)} gives the best file; profile rd only",
    )
    time_limit_s: Number = _positive("time limit in seconds (default: the longest that the service allows)", 60)
    priority: Annotated[Priority, BeforeValidator(_choice)] = Field(
        default=PRIORITIES[0], description="interactive jobs run before bulk jobs"
    )

    @model_validator(mode="after")
    def _within_one_budget(self) -> EncodeOptions:
        given = [kind for kind in BUDGET_KINDS if getattr(self, kind) is not None]
        if len(given) > 1:
            raise ValueError(f"give one of {', '.join(BUDGET_KINDS)}; got {len(given)}")
        try:
            _ = self.budget
        except BudgetError as error:
            raise ValueError(str(error)) from error
        return self

    @property
    def budget(self) -> Budget:
        """The one that is given, or the one unasked."""
        budgets = ((kind, getattr(self, kind)) for kind in BUDGET_KINDS)
        return next((Budget(kind, value) for kind, value in budgets if value is not None), DEFAULT_BUDGET)

    def checked(self, longest_s: float) -> CheckedOptions:
        """All of it. longest_s: how long an encode may take, and does unasked, in seconds. Raises ProblemError 422."""
        seconds = longest_s if self.time_limit_s is None else self.time_limit_s
        if not (math.isfinite(seconds) and 0 < seconds <= longest_s):
            raise ProblemError(422, f"time_limit_s must be more than 0 and at most {longest_s:g}")
        try:
            tune = tuning(self.tune, self.profile, self.budget)
            settings = settings_of(self.profile, self.effort)
        except BudgetError as error:
            raise ProblemError(422, str(error)) from error
        if not isinstance(settings, RdSettings) and find_spec("torch") is None:
            raise ProblemError(422, f"profile {self.profile} needs PyTorch, which this service lacks; use profile rd")
        budget = self.budget
        request = EncodeRequest(budget.kind, budget.value, self.profile, seconds, tune, self.effort)
        return CheckedOptions(request, self.priority, budget is not DEFAULT_BUDGET)


OPTIONS = tuple(EncodeOptions.model_fields)
OPTION_SCHEMAS: dict[str, dict[str, Any]] = {
    name: {word: value for word, value in schema.items() if word != "title" and value is not None}
    for name, schema in EncodeOptions.model_json_schema()["properties"].items()
}


def read_options(given: Sequence[tuple[str, UploadFile | str]]) -> EncodeOptions:
    """The fields among what was given, from the query and the form alike. Raises ProblemError 422."""
    texts: dict[str, str] = {}
    for name, value in given:
        if name == IMAGE_FIELD:
            raise ProblemError(422, f"{IMAGE_FIELD} is not accepted here: send it in the body of POST /encode")
        if name in texts:
            raise ProblemError(422, f"the field {name} is given twice")
        if name in OPTIONS and not isinstance(value, str):
            raise ProblemError(422, f"the field {name} must be text, not a file")
        texts[name] = str(value)
    try:
        return EncodeOptions.model_validate(texts)
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "extra_forbidden":
            detail = f"unknown field {first['loc'][0]!r}; the fields are {IMAGE_FIELD}, {', '.join(OPTIONS)}"
        else:
            detail = str(first["ctx"]["error"])
        raise ProblemError(422, detail) from error


def feasible(checked: CheckedOptions, image: SourceImage) -> CheckedOptions:
    """The same, with the default budget raised to the smallest file for a tiny image. Raises ProblemError 422 if no
    file of the image meets the budget."""
    request, settings = checked.request, PROFILES[checked.request.profile]
    budget, pixels = Budget(request.budget_kind, request.budget_value), image.width * image.height
    if not checked.has_budget:
        budget = default_budget(image.width, image.height, smallest_file(settings, has_alpha=True))
        return replace(checked, request=replace(request, budget_kind=budget.kind, budget_value=budget.value))
    if budget.kind in ("looks", "quality") and not isinstance(settings, RdSettings):
        detail = f"profile {request.profile} has no {budget.kind} scale; use bpp, bytes, psnr or gaussians"
        raise ProblemError(422, detail)
    if budget.kind == "looks" and min(image.width, image.height) < SMALLEST_SIDE:
        raise ProblemError(422, f"looks are undefined for sides below {SMALLEST_SIDE} pixels")
    if budget.kind == "gaussians" and budget.value > pixels:
        raise ProblemError(422, f"{budget.value:.0f} Gaussians exceed the image's {pixels} pixels")
    allowed, least = budget.max_bytes(image.width, image.height), smallest_file(settings)
    if allowed is not None and allowed < least:
        detail = f"a file of profile {request.profile} takes at least {least} bytes, the budget is {allowed}"
        raise ProblemError(422, detail)
    return checked
