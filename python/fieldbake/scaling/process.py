"""Calls in a child process. A call that crashes, runs out of memory or takes too long ends only the child."""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
import warnings
import weakref
from collections.abc import Callable
from typing import IO, Any

from ..base.errors import Error

#: Eight bytes before each message: its length.
_LENGTH = struct.Struct("<Q")

#: Program of a child. Its import path is the path of its parent. The main program of the parent is not imported again.
_PROGRAM = "import sys; sys.path[:] = {path!r}; from fieldbake.scaling import library, process; process.serve()"


class ChildError(Error):
    """The child process ended before it returned a result."""


class UnsendableError(Error):
    """The call cannot be pickled, or the child cannot read it."""


class Portable:
    """A callable that cloudpickle carries to other processes, also from a script or notebook.

    The package cloudpickle is installed with Dask.
    """

    def __init__(self, function: Callable[[], Any]) -> None:
        self.function = function

    def __call__(self) -> Any:
        """Call the function."""
        return self.function()

    def __reduce__(self) -> tuple[Any, ...]:
        try:
            cloudpickle = importlib.import_module("cloudpickle")
        except ImportError:
            return Portable, (self.function,)
        return _portable, (cloudpickle.dumps(self.function),)


def _portable(data: bytes) -> Portable:
    return Portable(pickle.loads(data))


class Child:
    """A process that makes one call at a time. It starts with the first call, and again after it was lost."""

    def __init__(self, threads: int | None = None) -> None:
        self._threads = threads
        self._process: subprocess.Popen[bytes] | None = None

    def call(self, function: Callable[..., Any], *arguments: Any, limit_s: float | None = None) -> Any:
        """Call a function in the child; return its result, or raise its exception.

        Raises
        ------
        ChildError
            If the process dies, or takes longer than `limit_s` seconds.
        UnsendableError
            If the call cannot be pickled. Functions that are defined in other functions or in the main program cannot.
        """
        try:
            message = pickle.dumps((function, arguments), pickle.HIGHEST_PROTOCOL)
        except Exception as error:  # each type has errors of its own
            raise UnsendableError(str(error)) from error
        process = self._process
        if process is None or process.poll() is not None:
            process = self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        expired = threading.Event()
        timer = None
        if limit_s is not None:

            def stop() -> None:
                expired.set()
                process.kill()

            timer = threading.Timer(limit_s, stop)
            timer.daemon = True
            timer.start()
        try:
            _send(process.stdin, message)
            answer = _receive(process.stdout)
        except OSError:
            answer = None
        except BaseException:
            # The next call would receive the answer to the interrupted call.
            self.close()
            raise
        finally:
            if timer is not None:
                timer.cancel()
        if answer is None:
            code = process.wait()
            self.close()
            if expired.is_set():
                raise ChildError(f"took longer than the limit of {limit_s:g} s and was stopped")
            raise ChildError(_epitaph(code))
        succeeded, value = pickle.loads(answer)
        if succeeded:
            return value
        raise value

    def stop(self) -> None:
        """End the process from another thread; the call in progress raises `ChildError`."""
        process = self._process
        if process is not None:
            process.kill()

    def close(self) -> None:
        """End the process, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            _end(process)

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the process, and wait until it has imported the package: time limits begin then."""
        self.close()
        environment = dict(os.environ)
        if self._threads is not None:
            environment.setdefault("RAYON_NUM_THREADS", str(self._threads))
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM.format(path=[os.path.abspath(entry) for entry in sys.path])],  # noqa: PTH100 - "" is the working directory
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        # The process ends with the thread that uses it.
        weakref.finalize(self, _end, self._process)
        assert self._process.stdout is not None
        try:
            # The end of a process that does not start is found by the call.
            _receive(self._process.stdout)
        except BaseException:
            self.close()
            raise
        return self._process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        # Bytes that the process has not read cannot be flushed.
        with contextlib.suppress(OSError):
            stream.close()  # type: ignore[union-attr]


def _epitaph(code: int) -> str:
    if code >= 0:
        return f"its process ended with exit status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    hint = "; the machine may be out of memory" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{hint}"


def _send(stream: IO[bytes], message: bytes) -> None:
    stream.write(_LENGTH.pack(len(message)))
    stream.write(message)
    stream.flush()


def _receive(stream: IO[bytes]) -> bytes | None:
    """Read the next message; None at the end of the stream."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack(head)
    message = stream.read(length)
    return message if len(message) == length else None


def serve() -> None:
    """Make the calls that arrive on standard input, until it ends."""
    # Ctrl-C reaches the whole group of processes; the parent decides what follows.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Standard error leads nowhere; warnings are part of the reports.
    warnings.simplefilter("ignore")
    source = sys.stdin.buffer
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as target:
        # Prints of libraries must not mix with the answers.
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        _send(target, b"")
        while (message := _receive(source)) is not None:
            _send(target, _answer(message))


def _answer(message: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(message)
    except Exception as error:  # modules that only the parent has
        return pickle.dumps((False, UnsendableError(str(error))), pickle.HIGHEST_PROTOCOL)
    try:
        return pickle.dumps((True, function(*arguments)), pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # it is raised in the parent
        try:
            answer = pickle.dumps((False, error), pickle.HIGHEST_PROTOCOL)
            pickle.loads(answer)
        except Exception:  # an exception that cannot be pickled
            return pickle.dumps((False, Error(f"{type(error).__name__}: {error}")), pickle.HIGHEST_PROTOCOL)
        return answer
