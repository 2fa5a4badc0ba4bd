"""Times, memory and records that all benchmarks share.

`interleaved` takes the times of several jobs in turns, so that a machine that slows down slows every job. `record`
passes the result of a comparison on to `run.py`, which collects the summary.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

#: A job whose run takes longer than this is not repeated, seconds.
LONG_S = 20.0


@dataclass
class Times:
    """The runs of one job: elapsed seconds, processor seconds of all threads, and the last result."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    result: Any = None

    @property
    def median(self) -> float:
        return statistics.median(self.wall)

    @property
    def least(self) -> float:
        return min(self.wall)

    @property
    def least_cpu(self) -> float:
        return min(self.cpu)

    @staticmethod
    def processor_seconds() -> float:
        """Processor time of this process, and of its children that have ended."""
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    def run(self, job: Callable[[], Any]) -> None:
        """Call the job once and add its times."""
        self.result = None
        wall, cpu = time.perf_counter(), self.processor_seconds()
        self.result = job()
        self.wall.append(time.perf_counter() - wall)
        self.cpu.append(self.processor_seconds() - cpu)


def interleaved(jobs: Mapping[str, Callable[[], Any]], rounds: int = 3) -> dict[str, Times]:
    """Run each job `rounds` times, in turns; long ones once."""
    times = {name: Times() for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            if not times[name].wall or times[name].least < LONG_S:
                times[name].run(job)
    return times


def timed(job: Callable[[], Any], rounds: int = 1) -> Times:
    """Run one job `rounds` times."""
    return interleaved({"": job}, rounds)[""]


def record(question: str, peer: str, ours: float, theirs: float) -> None:
    """Add a comparison to the summary of `run.py`: the times of fieldbake and of a peer for the same work, seconds.

    A program that is started by hand has no summary, and the call does nothing.
    """
    if path := os.environ.get("FIELDBAKE_BENCH_RECORD"):
        row = {"question": question, "peer": peer, "ours": ours, "theirs": theirs}
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def absent(peer: str, error: BaseException) -> None:
    """Name a peer that cannot be measured, with the reason, on standard output and in the summary."""
    lines = str(error).strip().splitlines()
    reason = f"{type(error).__name__}: {lines[0] if lines else ''}"
    print(f"{peer} is left out: {reason}")
    if path := os.environ.get("FIELDBAKE_BENCH_RECORD"):
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps({"absent": peer, "reason": reason}) + "\n")


def reset_peak() -> None:
    """Reset the peak where the system supports it (Linux)."""
    reset = Path("/proc/self/clear_refs")
    if reset.exists():
        reset.write_text("5")


def peak_mib() -> float:
    """Peak of the resident memory of this process since the last reset."""
    status = Path("/proc/self/status")
    if status.exists():
        # Not ru_maxrss, which on Linux starts at the level of the process that started this one.
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) / 1024
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def machine() -> str:
    """Processor, number of cores, system and version of Python."""
    processor = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []:
        if line.startswith("model name"):
            processor = line.split(":")[1].strip()
            break
    return f"{processor}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def run_table(tables: dict[str, tuple[Callable[[int], object], int]], description: str | None) -> None:
    """Run the table that the command line names, with its own count or `--count`, and print the processor time."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=tables)
    parser.add_argument("--count", type=int)
    options = parser.parse_args()
    table, count = tables[options.table]
    taken = timed(lambda: table(options.count or count))
    print(f"{taken.least_cpu:.0f} s of processors")
