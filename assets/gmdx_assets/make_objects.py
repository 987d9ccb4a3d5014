"""Makes the bundled object files: `python -m gmdx_assets.make_objects [--out DIR] [--check]`."""

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gmdx_assets.parametric import SHAPES, Solid

logger = logging.getLogger("gmdx")

FOLDER = Path(__file__).parent / "objects"
DIGITS = 6  # of a metre: coordinates are whole micrometres
TOLERANCE = 2e-6  # m, between a file and what the code makes


def obj_text(name: str, solid: Solid) -> str:
    """The solid as an obj file."""
    lines = [f"# {name}: made by gmdx_assets.make_objects; metres; Apache-2.0", f"o {name}"]
    # Adding zero turns -0.0 into 0.0.
    rounded = np.round(solid.vertices, DIGITS) + 0.0
    lines += [f"v {x:.{DIGITS}f} {y:.{DIGITS}f} {z:.{DIGITS}f}" for x, y, z in rounded]
    lines += [f"f {a} {b} {c}" for a, b, c in solid.faces + 1]
    return "\n".join(lines) + "\n"


def read_obj(path: Path) -> Solid:
    """A file that `obj_text` made.

    Raises:
        OSError: If the file cannot be read.
    """
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = [[float(value) for value in row[1:]] for row in rows if row[0] == "v"]
    faces = [[int(value) - 1 for value in row[1:]] for row in rows if row[0] == "f"]
    return Solid(np.array(vertices), np.array(faces, np.int64))


def difference(a: Solid, b: Solid) -> float:
    """Largest distance from a vertex of either solid to the nearest of the other, m."""
    from scipy.spatial import cKDTree

    there, _ = cKDTree(a.vertices).query(b.vertices)
    back, _ = cKDTree(b.vertices).query(a.vertices)
    return float(max(np.max(there), np.max(back)))


def main(argv: Sequence[str] | None = None) -> int:
    """Writes the files, or compares them with the code; returns the exit code."""
    parser = argparse.ArgumentParser(prog="gmdx_assets.make_objects", description=__doc__)
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder of the files")
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit 1 if a file differs from the code"
    )
    options = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    different = 0
    if not options.check:
        options.out.mkdir(parents=True, exist_ok=True)
    for name, make in SHAPES.items():
        solid = make()
        path: Path = options.out / f"{name}.obj"
        if not options.check:
            path.write_text(obj_text(name, solid))
            logger.info("%s: %d triangles", path.name, len(solid.faces))
        elif not path.is_file():
            logger.info("%s: no such file", path)
            different += 1
        elif (gap := difference(solid, read_obj(path))) > TOLERANCE:
            logger.info("%s: differs from the code by %.2g m", path, gap)
            different += 1
        else:
            logger.info("%s: as the code makes it", path.name)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
