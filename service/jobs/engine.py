"""The engine that wakes workers on other machines: Procrastinate, in PostgreSQL beside the job table.

A job of the engine is an anonymous token. It says only that some row of the job table can be claimed. When a worker
holds the token, the table decides which row, because only the table knows priorities, turns and limits. So the engine
may lose a token or have one too many: a token without a row ends at once, and every worker adds missing tokens, such as
those of lost workers.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

import psycopg
from procrastinate import App, PsycopgConnector, SyncPsycopgConnector
from procrastinate.exceptions import ProcrastinateException
from procrastinate.jobs import Status
from procrastinate.schema import SchemaManager
from psycopg_pool import ConnectionPool

from service.process.loops import PeriodicThread, StopSignal

Pool = ConnectionPool[psycopg.Connection[psycopg.rows.DictRow]]

log = logging.getLogger(__name__)

QUEUE = "encode"
TASK = "encode_next"
# The engine misses a notification that arrives while it fetches, so it also polls.
POLL_S = 1.0
TOP_UP_S = 1.0
INSIST_S = 2.0
PAUSE_AFTER_TROUBLE_S = 1.0
PATIENCE_S = 5.0  # for a database that restarts

SCHEMA: str = SchemaManager.get_schema()


class Engine:
    """The engine's two sides: tokens are deferred, and workers are woken by them.

    pool: connections to count tokens on; conninfo: how to reach the database; lease_s: seconds until a silent worker
    counts as lost; session: statements for each new connection, which put the engine's tables on its search path.
    """

    def __init__(self, pool: Pool, conninfo: str, lease_s: float, session: bytes) -> None:
        self._conninfo = conninfo
        self._lease_s = lease_s
        self._session = session
        logging.getLogger("procrastinate").setLevel(logging.CRITICAL)  # its tracebacks are one line here
        self._deferrer = App(connector=SyncPsycopgConnector()).open(pool)

    def defer(self, connection: psycopg.Connection[psycopg.rows.DictRow]) -> None:
        """Add a token within the connection's transaction."""
        self._deferrer.configure_task(TASK, queue=QUEUE, connection=connection).defer()

    def waiting(self) -> int:
        """Return the number of tokens that no worker holds."""
        return sum(queue["todo"] for queue in self._deferrer.job_manager.list_queues(QUEUE))

    def dispatch(self, run_next: Callable[[], bool], top_up: Callable[[], None], stop: StopSignal) -> None:
        """Call run_next for each token, and top_up every second, until stopping is requested."""
        refilling = PeriodicThread("refilling the queue engine", top_up, TOP_UP_S, stop)
        refilling.start()
        while not stop.requested:
            try:
                asyncio.run(self._serve(run_next, stop))
            except asyncio.CancelledError:  # raised by _cancel_on()
                continue
            except (ProcrastinateException, psycopg.Error) as error:
                log.warning("the queue engine is unreachable: %s", in_words(error))
            stop.wait(PAUSE_AFTER_TROUBLE_S)
        refilling.join(INSIST_S)

    async def _serve(self, run_next: Callable[[], bool], stop: StopSignal) -> None:
        """Work until stopping is requested, which cancels this, or until the database is lost."""
        # Without these limits it would wait for minutes after an outage, and before stopping during one.
        connector = PsycopgConnector(
            conninfo=self._conninfo,
            configure=self._configure,
            min_size=1,
            max_size=2,
            timeout=PATIENCE_S,
            reconnect_timeout=PATIENCE_S,
        )
        app = App(connector=connector)
        app.task(name=TASK, queue=QUEUE)(run_next)
        # The handler receives errors such as the end of a token that another worker has taken over.
        asyncio.get_running_loop().set_exception_handler(_log)
        _cancel_on(stop)
        async with app.open_async():
            # Tokens that lost workers held. Their jobs have new ones by now.
            for token in await app.job_manager.get_stalled_jobs(queue=QUEUE, seconds_since_heartbeat=self._lease_s):
                await app.job_manager.finish_job(token, Status.FAILED, delete_job=True)
            await app.run_worker_async(
                queues=[QUEUE],
                install_signal_handlers=False,
                fetch_job_polling_interval=POLL_S,
                update_heartbeat_interval=self._lease_s / 3,
                stalled_worker_timeout=self._lease_s,
                delete_jobs="always",
            )

    async def _configure(self, connection: psycopg.AsyncConnection) -> None:
        await connection.execute(self._session)
        await connection.commit()


def _log(_loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    error = context.get("exception")
    log.warning("queue engine: %s", in_words(error) if error else context["message"])


def in_words(error: BaseException) -> str:
    """Return an error as one line. The engine's own errors say little; their cause says more."""
    return " ".join(str(error.__cause__ or error).split())


def _cancel_on(stop: StopSignal) -> None:
    """Cancel the current task once stopping is requested, and again until it ends.

    The first cancellation makes the engine wait for its running task and then unregister in the database. The next one
    ends that wait.
    """
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None

    def cancel() -> None:
        loop.remove_reader(stop.fileno())
        task.cancel()
        loop.call_later(INSIST_S, cancel)

    loop.add_reader(stop.fileno(), cancel)
