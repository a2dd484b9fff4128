"""The sandbox: `service.sandbox.server DESCRIPTOR LOG_FORMAT WATCHED ABSENT...`. It has the codec in memory, and forks.

It reads no upload, and has one thread. Each fork does one task. Two forks wait in advance, so that no client waits for
a fork. The sandbox ends when all its clients have closed their sockets, and its forks end with it.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import math
import os
import resource
import select
import selectors
import signal
import socket
import sys
import time
import traceback
from collections.abc import Collection
from typing import NoReturn

from pydantic import TypeAdapter

from service.logs import log_seldom, set_up_logging
from service.processes import Pulse
from service.sandbox.confinement import SandboxError, confine, die_first, end_with, set_name
from service.sandbox.frames import MAX_TASK_BYTES, AnyTask, Begun, Crashed, Encode, Ended, packed
from service.sandbox.tasks import ERROR_LENGTH, Answer, perform, prepare, set_threads, warm_fork, warm_up

WAITING_FORKS = 2
MAX_DESCRIPTORS = 1 << 20
CONTROL_BYTES = 64
LOOK_S = 1.0  # how often tasks are looked at, at least
PAUSE_S = 0.25  # after a fork that ended without a task
# Encodes have the lowest priority, so that responses are fast while every core encodes. Pictures come after the web
# process and before encodes, since no request waits for an encode. Those that have used more than SHORT_CPU_S of a core
# get the priority of an encode: two of one client left an encode 2 % of a core. So do pictures from the start if those
# before them had more than EAGER_SHARE of what all tasks used: many of less than a second each left an encode 5 %.
ENCODE_NICENESS, PICTURE_NICENESS = 19, 5
SHORT_CPU_S = 0.5
EAGER_SHARE, RECENT_CPU_S = 0.2, 5.0

log = logging.getLogger("service.sandbox.server")  # its __name__ is __main__
_tasks: TypeAdapter[AnyTask] = TypeAdapter(AnyTask)


class TaskProcess:
    """A forked process for one task.

    control: socket on which it receives the task; answer: blocking socket shared with the client, set once the task is
    known; status: exit status, once it has ended.
    """

    def __init__(self, number: int, control: socket.socket) -> None:
        self.number = number
        self.control = control
        self.answer: socket.socket | None = None
        self.status: int | None = None

    def cpu_s(self) -> float:
        """Seconds of a core that the task has used, until it is reaped."""
        return time.clock_gettime(~self.number << 3 | 2)  # its id by clock_getcpuclockid()

    def eager_s(self) -> float:
        """Those that it has used before encodes; 0 if it has their priority."""
        return 0.0 if os.getpriority(os.PRIO_PROCESS, self.number) == ENCODE_NICENESS else self.cpu_s()

    def lower(self) -> None:
        """Give the task the priority of an encode."""
        with contextlib.suppress(OSError):  # as for root without CAP_SYS_NICE, whose tasks are another user's
            os.setpriority(os.PRIO_PGRP, self.number, ENCODE_NICENESS)  # all its threads


class Server:
    """Hands tasks to forks, ends those whose clients have disconnected, and reports how each ended.

    absent: layers of confinement that the system lacks, and tasks do without; watched: number of its parent, which it
    kills if that hangs, or 0.
    """

    def __init__(self, requests: socket.socket, absent: Collection[str], watched: int) -> None:
        self._requests = requests
        self._watched, self._pulse = watched, Pulse(watched)
        self._used_s = 0.0  # by all tasks
        self._eager_s = 0.0  # by pictures before encodes; it fades
        self._absent = absent
        self._waiting: list[TaskProcess] = []
        self._forks: dict[int, TaskProcess] = {}  # all that have not ended, by number
        self._selector = selectors.DefaultSelector()
        self._selector.register(requests, selectors.EVENT_READ)
        # A word comes here when a fork has ended. Its descriptors tell nothing: it may have closed them and stay.
        self._ends, self._wakes = socket.socketpair()
        for each in (self._ends, self._wakes):
            each.setblocking(False)
        self._selector.register(self._ends, selectors.EVENT_READ)
        signal.set_wakeup_fd(self._wakes.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda _number, _frame: None)  # else nothing would be written there

    def run(self) -> None:
        """Serve until all clients have disconnected."""
        while True:
            self._fork()
            if self._watched == os.getppid() and self._pulse.has_stopped():
                log.error("the process that runs this sandbox hangs: killing it")
                os.kill(self._watched, signal.SIGKILL)
            for key, _ in self._selector.select(LOOK_S):
                if key.fileobj is self._requests:
                    if not self._take():
                        return
                elif key.fileobj is self._ends:
                    self._reap()
                elif key.data.answer is not None:  # another event of this round may have closed it
                    self._serve(key.data, key.data.answer)
            for fork in self._forks.values():
                if fork.answer is not None and fork.eager_s() > SHORT_CPU_S:
                    self._note(fork)
                    fork.lower()

    def _note(self, fork: TaskProcess | None = None) -> None:
        """Add what a picture has used before encodes; what came before fades as tasks use processors."""
        ended = resource.getrusage(resource.RUSAGE_CHILDREN)
        used_s = ended.ru_utime + ended.ru_stime + sum(one.cpu_s() for one in self._forks.values())
        self._eager_s *= math.exp((self._used_s - used_s) / RECENT_CPU_S)
        self._eager_s += fork.eager_s() if fork else 0.0
        self._used_s = used_s

    def _fork(self) -> None:
        """Fork until WAITING_FORKS processes wait for tasks."""
        try:
            while len(self._waiting) < WAITING_FORKS:
                ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                with theirs:
                    parent = os.getpid()
                    number = os.fork()
                    if number == 0:
                        run_fork(theirs.fileno(), parent, self._absent)
                self._forks[number] = TaskProcess(number, ours)
                self._waiting.append(self._forks[number])
        except OSError as error:  # as when processes or memory run out; it is tried again each second
            log_seldom(log, "the sandbox cannot fork: %s", error)

    def _take(self) -> bool:
        """Hand a task to a fork, and drop malformed requests. Returns False once all clients have disconnected."""
        line, descriptors, _, _ = socket.recv_fds(self._requests, MAX_TASK_BYTES, 2)
        if not line and _is_closed(self._requests):
            return False
        try:
            number, file = descriptors
            answer = socket.socket(fileno=number)
        except (ValueError, OSError):
            for descriptor in descriptors:
                os.close(descriptor)
            return True
        while self._waiting:
            fork = self._waiting.pop(0)
            try:
                socket.send_fds(fork.control, [line], [answer.fileno(), file])
            except OSError:  # it died while it waited
                continue
            fork.answer = answer
            self._note()
            if self._eager_s > EAGER_SHARE * RECENT_CPU_S:
                fork.lower()
            self._selector.register(answer, selectors.EVENT_READ, fork)
            break
        else:
            answer.close()
        os.close(file)
        return True

    def _serve(self, fork: TaskProcess, answer: socket.socket) -> None:
        """Handle a client's socket: it has disconnected, or has space for the last frame."""
        if fork.status is not None:
            self._send_end(fork, answer)
            return
        os.kill(fork.number, signal.SIGKILL)
        self._close_answer(fork, answer)

    def _reap(self) -> None:
        self._ends.recv(CONTROL_BYTES)
        while self._forks and (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)):
            fork = self._forks[ended.si_pid]
            self._note(fork)
            del self._forks[fork.number]
            self._end(fork, os.waitstatus_to_exitcode(os.waitpid(fork.number, 0)[1]))

    def _end(self, fork: TaskProcess, status: int) -> None:
        fork.status = status
        fork.control.close()
        if fork in self._waiting:
            self._waiting.remove(fork)
            log_seldom(log, "a fork of the sandbox ended as it waited, with status %s", fork.status)
            time.sleep(PAUSE_S)  # the next may end the same way
        if fork.answer is not None:
            self._send_end(fork, fork.answer)

    def _send_end(self, fork: TaskProcess, answer: socket.socket) -> None:
        assert fork.status is not None
        try:
            answer.send(packed(Ended(status=fork.status)), socket.MSG_DONTWAIT)
        except BlockingIOError:
            self._selector.modify(answer, selectors.EVENT_WRITE, fork)
            return
        except OSError:
            pass
        self._close_answer(fork, answer)

    def _close_answer(self, fork: TaskProcess, answer: socket.socket) -> None:
        self._selector.unregister(answer)
        answer.close()
        fork.answer = None


def _is_closed(connection: socket.socket) -> bool:
    """Whether the other end is closed. Reading nothing does not prove it, since a message may be empty."""
    poll = select.poll()
    poll.register(connection, 0)  # a hang-up is always reported
    return bool(poll.poll(0))


def run_fork(control: int, parent: int, absent: Collection[str]) -> NoReturn:
    """Wait for a task and do it. The exit status is 0 once its result is sent."""
    status = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        end_with(parent)
        die_first()
        _close_other_descriptors(control)
        set_name("waits for a task")
        os.setpgid(0, 0)
        os.nice(PICTURE_NICENESS)
        warm_fork()
        held = socket.socket(fileno=control)  # open until this process ends: that tells the sandbox
        line, descriptors, _, _ = socket.recv_fds(held, MAX_TASK_BYTES, 2)
        if line:
            answer, file = descriptors
            status = _run_task(line, answer, file, parent, absent)
    finally:
        os._exit(status)


def _run_task(line: bytes, answer: int, file: int, parent: int, absent: Collection[str]) -> int:
    to_client = Answer(answer)
    try:
        task = _tasks.validate_json(line)
        if isinstance(task, Encode):
            os.nice(ENCODE_NICENESS)
        set_name(task.job_id if isinstance(task, Encode) else task.kind)
        to_client.send(Begun())  # last, so that a task that has begun has its name
        data = _read_whole(file)
        os.close(file)
        prepare(task)
        missing = set(confine(task.memory_bytes, task.cpu_s, task.max_threads, parent)).difference(absent)
        if missing:  # it failed for this task alone, as when memory is short
            raise SandboxError(f"it was not confined by {' and '.join(sorted(missing))}")
        set_threads(task.threads)
        perform(task, data, to_client)
    except Exception as error:
        last = traceback.format_exception_only(error)[-1].strip()
        to_client.send(Crashed(detail=last[:ERROR_LENGTH]))
        return 1
    return 0


def _close_other_descriptors(kept: int) -> None:
    """Close the descriptors of other tasks."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(nothing, descriptor)
    os.closerange(3, kept)
    os.closerange(kept + 1, MAX_DESCRIPTORS)


def _read_whole(file: int) -> bytes:
    """Read the file from its beginning, whatever the position of its descriptor."""
    size = os.fstat(file).st_size
    data = bytearray()
    while len(data) < size and (more := os.pread(file, size - len(data), len(data))):
        data += more
    return bytes(data)


def main() -> None:
    """Serve the socket that the command line names."""
    descriptor, log_format, watched, *absent = sys.argv[1:]
    set_up_logging("json" if log_format == "json" else "text")
    for number in (signal.SIGTERM, signal.SIGINT):  # it ends with its clients
        signal.signal(number, signal.SIG_IGN)
    requests = socket.socket(fileno=int(descriptor))
    warm_up()
    gc.collect()
    gc.freeze()  # so that forks share it
    server = Server(requests, absent, int(watched))
    try:
        server.run()
    finally:
        signal.set_wakeup_fd(-1)  # the socket closes before the last forks end


if __name__ == "__main__":
    main()
