"""Every benchmark, one after another, and a summary of the ratios to other tools.

    make bench     or     python benches/run.py      below 40 minutes

Each benchmark runs in a process of its own with a time limit. Its output and its comparisons are kept in
`results/bench-unfinished.json` as soon as it ends: a run that was interrupted goes on there, unless the commit has
changed. A benchmark that fails or reaches its limit is named in the summary, and its comparisons until then are kept.
At the end the file becomes `results/DATE-bench.json`, from which docs/benchmarks.md draws its picture, and the
summary is written to `results/DATE-bench.md`.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from measuring import machine

HERE = Path(__file__).parent
RESULTS = HERE / "results"
UNFINISHED = RESULTS / "bench-unfinished.json"

#: Name, command and time limit in seconds: less than 40 minutes in all, once the libraries of other tools are built.
BENCHES: list[tuple[str, list[str], int]] = [
    (
        "libraries",
        [
            "-c",
            "import csg_peers, exactness, peers; exactness.brute_library(); csg_peers.fidget_library(); peers.peers()",
        ],
        300,
    ),
    ("grids", ["peers.py", "-n", "2", "-r", "64", "-r", "128", "--mesh", "{bunny}", "--mesh", "{spot}"], 540),
    ("points", ["peers.py", "-p", "1", "-p", "200000", "--mesh", "{bunny}", "-o", "{results}/{date}-points.md"], 180),
    ("queries", ["queries.py", "{bunny}", "--count", "200000"], 120),
    ("fields", ["raymarch_peers.py"], 60),
    ("scene", ["scene.py"], 120),
    ("shapes", ["csg_peers.py", "--size", "256"], 150),
    ("everyday", ["everyday.py"], 90),
    ("solids", ["solids.py", "--mesh", "{bunny}", "-r", "128"], 60),
    ("curves", ["curves.py"], 480),
    ("exactness", ["exactness.py", "-r", "32"], 150),
    ("sparse", ["sparse.py", "-r", "256"], 60),
    ("atlas", ["atlas.py"], 60),
    ("parts", ["csg.py"], 60),
    ("quadrics", ["quadrics.py"], 30),
    ("merge", ["merge.py"], 60),
    ("devices", ["devices.py"], 60),
]


def run(command: list[str], limit_s: int) -> dict[str, Any]:
    """Run one benchmark. Returns its output, comparisons, time, load before it, and how it ended."""
    load, start = os.getloadavg()[0], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        record, output = Path(folder, "record"), Path(folder, "output")
        record.touch()
        environment = {**os.environ, "FIELDBAKE_BENCH_RECORD": str(record), "PYTHONWARNINGS": "ignore"}
        with output.open("w") as file:
            # A process group of its own, so that its children end with it.
            process = subprocess.Popen(
                [sys.executable, *command], cwd=HERE, env=environment, stdout=file, stderr=file, start_new_session=True
            )
            try:
                code = process.wait(limit_s)
                end = "done" if code == 0 else f"failed with status {code}"
            except subprocess.TimeoutExpired:
                end = f"stopped at its limit of {limit_s} s"
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            except BaseException:
                os.killpg(process.pid, signal.SIGKILL)
                raise
        rows = [json.loads(line) for line in record.read_text().splitlines()]
        text = output.read_text(errors="replace")
    return {"end": end, "seconds": time.monotonic() - start, "load": load, "rows": rows, "output": text}


def duration(seconds: float) -> str:
    """A time with three digits in a unit of its size."""
    unit, factor = next(
        (u, f) for u, f in (("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)) if seconds * f >= 1 or u == "ns"
    )
    return f"{seconds * factor:.3g} {unit}"


def questions(benches: dict[str, Any]) -> list[dict[str, Any]]:
    """One row for each compared job: the time of fieldbake, and the ratios of other tools to it, the best one first."""
    found: dict[str, dict[str, Any]] = {}
    for bench in benches.values():
        for row in bench["rows"]:
            if "question" in row:
                entry = found.setdefault(
                    row["question"], {"question": row["question"], "ours": row["ours"], "ratios": {}}
                )
                entry["ratios"][row["peer"]] = row["theirs"] / row["ours"]
    for entry in found.values():
        entry["ratios"] = dict(sorted(entry["ratios"].items(), key=lambda item: item[1]))
    return list(found.values())


def summary(run_of: dict[str, Any]) -> str:
    """The summary in Markdown."""
    benches = run_of["benches"]
    loads = [bench["load"] for bench in benches.values()]
    minutes = sum(bench["seconds"] for bench in benches.values()) / 60
    lines = [
        f"# Summary, {run_of['date']}",
        "",
        f"{run_of['machine']}. `make bench` took {minutes:.0f} minutes. The load of the machine before each benchmark "
        f"was {min(loads):.1f} to {max(loads):.1f}. A ratio is the time of the other tool divided by the time of "
        "fieldbake for the same work; above 1, fieldbake is faster. Times of distances, points "
        "and rays are times of one item.",
        "",
        "| work | fieldbake | best other tool | ratio | further tools |",
        "|---|---|---|---|---|",
    ]
    for entry in questions(benches):
        (best, ratio), *others = entry["ratios"].items()
        rest = ", ".join(f"{name} {value:.3g}" for name, value in others)
        lines.append(f"| {entry['question']} | {duration(entry['ours'])} | {best} | {ratio:.2f} | {rest} |")
    absent = {row["absent"]: row["reason"] for bench in benches.values() for row in bench["rows"] if "absent" in row}
    lines += ["", *(f"- {peer} is absent. {reason}" for peer, reason in absent.items())]
    lines += [f"- `{name}` {bench['end']}." for name, bench in benches.items() if bench["end"] != "done"]
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="benchmarks to run; all if not given")
    parser.add_argument("--fresh", action="store_true", help="start over instead of going on with an unfinished run")
    options = parser.parse_args()
    unknown = set(options.names) - {name for name, *_ in BENCHES}
    if unknown:
        parser.error(f"unknown benchmarks: {', '.join(sorted(unknown))}")

    git = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    commit = subprocess.run(git, cwd=HERE, capture_output=True, text=True).stdout.strip() or "unknown"
    state = {"date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(), "machine": machine(), "commit": commit}
    state["benches"] = {}
    if UNFINISHED.exists() and not options.fresh:
        before = json.loads(UNFINISHED.read_text())
        state = before if before["commit"] == commit else state
    meshes = Path(os.environ.get("FIELDBAKE_MESHES", HERE.parent / "../shared/meshes")).resolve()
    names = {
        "bunny": meshes / "stanford-bunny.obj",
        "spot": meshes / "spot/spot.obj",
        "results": RESULTS,
        "date": state["date"],
    }
    for name, command, limit_s in BENCHES:
        if options.names and name not in options.names:
            continue
        if state["benches"].get(name, {}).get("end") == "done":
            print(f"{name}: finished before")
            continue
        bench = run([word.format(**names) for word in command], limit_s)
        state["benches"][name] = bench
        UNFINISHED.write_text(json.dumps(state, indent=1))
        print(f"{name}: {bench['end']}, {bench['seconds']:.0f} s, load {bench['load']:.1f} before", flush=True)
        if bench["end"] != "done":
            print(bench["output"][-2000:])
    text = summary(state)
    print("\n" + text)
    if len(state["benches"]) == len(BENCHES):
        path = RESULTS / f"{state['date']}-bench.json"
        # The outputs name folders of this machine.
        state["benches"] = {
            name: {key: value for key, value in bench.items() if key != "output"}
            for name, bench in state["benches"].items()
        }
        path.write_text(json.dumps({**state, "questions": questions(state["benches"]), "summary": text}, indent=1))
        UNFINISHED.unlink()
        (RESULTS / f"{state['date']}-bench.md").write_text(text)


if __name__ == "__main__":
    main()
