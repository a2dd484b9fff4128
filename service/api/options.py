"""The query and the form of an encode: the codec's options, a budget, and a priority.

Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the image.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, WithJsonSchema
from pydantic.dataclasses import dataclass
from pydantic.json_schema import SkipJsonSchema

from service.api.problems import ProblemError
from service.jobs.job import EncodeRequest, ImageView, Priority
from sgmethod import profiles
from sgmethod.budget import BUDGET_KINDS, QUALITIES, bytes_value
from sgmethod.encode_arguments import EncodeArguments, EncodeOptions, only_budget


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


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class EncodeQuery(EncodeOptions):
    """Everything that a client may ask of an encode.

    Give at most one budget. The default is a quality of 60 in at most 0.5 bits per pixel.
    """

    bpp: Number = _positive("budget: maximum bits per pixel", 0.3)
    bytes: Annotated[Number, BeforeValidator(bytes_value), WithJsonSchema(BYTES_SCHEMA)] = _given(
        "budget: maximum bytes, such as 20000, 20k, 1.5MB or 20KiB", 20_000
    )
    quality: Annotated[
        Number, BeforeValidator(lambda text: QUALITIES.get(text, text)), WithJsonSchema(QUALITY_SCHEMA)
    ] = _given("budget: target SSIMULACRA 2, up to 100, or preview (40), web (60), archive (80); profile rd only", 60)
    psnr: Number = _positive("budget: target PSNR in dB, at most 60", 32)
    gaussians: Number = _positive("budget: number of Gaussians", 1000)
    priority: Priority = Field(default="interactive", description="interactive jobs run before bulk jobs")

    def checked(self) -> EncodeArguments:
        """Return the arguments of the encode. Raises BudgetError."""
        budget = only_budget(None, {kind: getattr(self, kind) for kind in BUDGET_KINDS})
        return EncodeArguments.checked(budget, self.profile, self.tune, self.effort)

    def request(self, image: ImageView, max_s: float) -> EncodeRequest:
        """Return the encoder's part of the request. max_s: the longest and default time limit in seconds.

        Raises BudgetError or ProblemError 422 if no file of the image could meet it.
        """
        seconds = max_s if self.time_limit_s is None else self.time_limit_s
        if not 0 < seconds <= max_s:
            raise ProblemError(422, f"time_limit_s must be more than 0 and at most {max_s:g}")
        asked = self.checked()
        if not all(map(find_spec, profiles.method_of(asked.profile).packages)):
            raise ProblemError(422, f"profile {asked.profile} needs PyTorch, which this service lacks; use profile rd")
        asked = asked.for_size(image.width, image.height, has_alpha=True)
        asked.check_size(image.width, image.height)
        taken = {"budget": asdict(asked.budget), "tune": asked.tune, "effort": asked.effort, "time_limit_s": seconds}
        return EncodeRequest.model_validate({**self.options(), **taken})


queries = TypeAdapter(EncodeQuery)


def _of_parameter(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a field as a parameter has it: without a title, and left out instead of null."""
    either = schema.get("anyOf", ())
    kind = {} if {"type": "null"} not in either else next(one for one in either if one != {"type": "null"})
    hidden = {"title", "anyOf"} if kind else {"title"}
    return {**kind, **{word: value for word, value in schema.items() if word not in hidden and value is not None}}


OPTION_SCHEMAS = {name: _of_parameter(schema) for name, schema in queries.json_schema()["properties"].items()}


def read_options(fields: Iterable[tuple[str, str]]) -> EncodeQuery:
    """Parse the options among the fields of the query and of a form. Raises ProblemError 422, BudgetError."""
    texts: dict[str, str] = {}
    for name, value in fields:
        if name in texts:
            raise ProblemError(422, f"the field {name} is given twice")
        texts[name] = value
    try:
        query = queries.validate_python(texts)
    except ValidationError as error:
        fault = error.errors()[0]
        field = fault["loc"][0]
        if fault["type"] == "unexpected_keyword_argument":
            raise ProblemError(422, f"unknown field {field!r}; the options are {', '.join(OPTION_SCHEMAS)}") from error
        raise ProblemError(422, f"{field}: {fault['msg']}") from error
    query.checked()
    return query
