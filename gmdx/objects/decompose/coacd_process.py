"""CoACD in a process of its own: it can crash, and once started it cannot be interrupted.

`run_coacd` starts this file as a script. The script imports nothing but numpy and coacd, so
that it starts fast; it reads one npz from standard input and writes one to standard output.
"""

import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

MAX_FACES = 2**20  # far above what CoACD finishes; guards the pipe against absurd input

Numbers = np.ndarray[Any, np.dtype[Any]]


class CoacdFailure(Exception):  # noqa: N818 - the outcome of an attempt, handled by the caller
    """CoACD crashed, ran out of time or returned nothing; the message says which."""


@dataclass(frozen=True)
class CoacdConfig:
    """How hard CoACD searches. Its own search is coarse here: merging repairs most of it."""

    seed: int = 0  # of its search
    resolution: int = 1000  # samples of its Hausdorff distance
    mcts_nodes: int = 10  # cutting planes tried in each direction of its tree search
    mcts_iterations: int = 15  # of its tree search, for each cut
    mcts_max_depth: int = 2  # cuts that its tree search looks ahead
    wall_factor: float = 10.0  # wall clock limit / CPU limit, for a busy machine


def run_coacd(
    vertices: Numbers,
    faces: Numbers,
    *,
    threshold: float,
    seconds: float,
    config: CoacdConfig = CoacdConfig(),
) -> tuple[Numbers, ...]:
    """Split a closed surface into nearly convex parts.

    Args:
        vertices: Vertices of a watertight 2-manifold surface, (v, 3) in m.
        faces: Its triangles, (f, 3), outward.
        threshold: Largest concavity of a part, m.
        seconds: CPU time after which the attempt is given up, s.
        config: Search effort and seed.

    Returns:
        The vertices of each part's convex hull, (_, 3) in m.

    Raises:
        CoacdFailure: it crashed, took too long, or returned no part.
    """
    options = asdict(config) | {"threshold": threshold, "seconds": seconds}
    if len(faces) > MAX_FACES:
        raise CoacdFailure(f"{len(faces)} triangles are too many (at most {MAX_FACES})")
    request = io.BytesIO()
    np.savez(
        request,
        vertices=np.asarray(vertices, np.float64),
        faces=np.asarray(faces, np.int32),
        options=np.array(json.dumps(options)),
    )
    # One thread: the same answer everywhere, and no more cores than the caller asked for.
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(Path(__file__).resolve()), str(os.getpid())],
            input=request.getvalue(),
            capture_output=True,
            timeout=max(1.0, seconds * config.wall_factor),
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise CoacdFailure(f"no result after {error.timeout:.0f} s on the clock") from error
    if done.returncode != 0 and done.returncode == -getattr(signal, "SIGXCPU", 0):
        raise CoacdFailure(f"no result after {seconds:g} s of CPU time")
    if done.returncode != 0:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise CoacdFailure(f"exit status {done.returncode} {' '.join(last)[:200]}".strip())
    with np.load(io.BytesIO(done.stdout)) as reply:
        parts = tuple(reply[f"arr_{i}"] for i in range(len(reply.files)))
    if not parts:
        raise CoacdFailure("no part was returned")
    return parts


def _decompose(vertices: Numbers, faces: Numbers, options: Mapping[str, Any]) -> list[Numbers]:
    import coacd

    coacd.set_log_level("off")
    parts = coacd.run_coacd(
        coacd.Mesh(vertices, faces),
        threshold=options["threshold"],
        real_metric=True,  # the threshold is in the mesh's own unit
        preprocess_mode="off",  # the surface is closed already, and this is ten times faster
        merge=False,  # parts are merged by what counts here, see decompose.py
        resolution=options["resolution"],
        mcts_nodes=options["mcts_nodes"],
        mcts_iterations=options["mcts_iterations"],
        mcts_max_depth=options["mcts_max_depth"],
        seed=options["seed"],
    )
    return [np.asarray(points, np.float64) for points, _ in parts]


def _limit_cpu(seconds: float) -> None:
    try:
        import resource
    except ImportError:  # not on Windows; the parent's wall clock limit remains
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    ceiling = resource.getrlimit(resource.RLIMIT_CPU)[1]
    limit = max(1, int(np.ceil(seconds)))
    if ceiling != resource.RLIM_INFINITY:
        limit = min(limit, ceiling)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, ceiling))


def _die_with(parent: int) -> None:
    """End this process soon after its parent has gone, even if that was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def main() -> None:
    """Serve one request from standard input."""
    reply = os.dup(1)
    os.dup2(2, 1)  # whatever the C++ side prints must not end up in the reply
    _die_with(int(sys.argv[1]))
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as request:
        options = json.loads(str(request["options"]))
        _limit_cpu(options["seconds"])
        parts = _decompose(request["vertices"], request["faces"], options)
    packed = io.BytesIO()
    np.savez(packed, *parts)
    with os.fdopen(reply, "wb") as stream:
        stream.write(packed.getvalue())


if __name__ == "__main__":
    main()
