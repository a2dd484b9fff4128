"""The errors that more than one package of the service raises or catches. Each message is one sentence."""


class JobTableError(Exception):
    """The job table cannot be read or written just now; trying again later may succeed."""


class LimitError(Exception):
    """A new job would exceed a limit. reason: "queue", "own_queue", "quota" or "own_quota"."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason = reason


class KeyReusedError(Exception):
    """An idempotency key came again with a different request."""


class MissingPackagesError(Exception):
    """The settings need packages that are not installed. The message has the command that installs them."""
