"""A contender in a process of its own: runs when it is told to on its standard input, answers in lines of JSON."""

import json
import os
import sys
import time
from importlib import import_module
from pathlib import Path

from experiments.bench.peers.contenders import CONTENDERS
from experiments.bench.work import load


def main(key: str, work_file: str, points: int, core: int) -> None:
    """Builds the contender, says so, and then runs it for as many seconds as each line says; an empty line ends."""
    contender = CONTENDERS[key]
    if core >= 0 and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[core]})
    work = load(Path(work_file))
    begin = time.perf_counter()
    try:
        run = import_module(f"experiments.bench.peers.{contender.module}").build(work, points, **contender.options)
        R, t = run()
    except ImportError as missing:
        print(json.dumps({"missing": str(missing)}), flush=True)
        return
    first = time.perf_counter() - begin
    begin = time.perf_counter()
    run()
    compile_s = max(0.0, first - (time.perf_counter() - begin))
    print(json.dumps({"R": R.tolist(), "t": t.tolist(), "compile_s": compile_s}), flush=True)
    frames = len(work.frames(points)) * contender.streams
    for line in sys.stdin:
        if not line.strip():
            return
        wall, used, runs = time.perf_counter(), time.process_time(), 0
        while runs == 0 or time.perf_counter() - wall < float(line):
            run()
            runs += 1
        wall, used = time.perf_counter() - wall, time.process_time() - used
        print(json.dumps({"fps": frames * runs / wall, "fps_of_processor": frames * runs / used}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
