"""Commands to copy, in the OpenAPI document and so at /docs; a test runs each of them."""

from __future__ import annotations

from typing import Any

from service.web.routes.answers import EXAMPLE_ID

HOST = "http://127.0.0.1:8000"
WORD = "x-codeSamples"  # what readers of such documents call them


def curl(arguments: str) -> dict[str, Any]:
    """The extra of an operation: a command. HOST and ID stand for the service and for a job."""
    source = f"curl {arguments}".replace("HOST", HOST).replace("ID", EXAMPLE_ID)
    return {WORD: [{"lang": "Shell", "label": "curl", "source": source}]}
