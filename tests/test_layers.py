"""Imports flow one way: mesh -> object -> ... -> studies. Read from the source with ast."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import gmdx

ROOT = Path(__file__).parents[1]
STAGES = (
    "objects", "scenes", "grasps", "trials", "metrics", "dataset", "evaluators", "detectors",
    "studies",
)  # fmt: skip
GROUND = ("errors", "arrays", "rng", "geometry", "config", "workers", "caches", "devices")
COMPOSERS = (
    "annotate",
    "batched",
    "pipeline",
    "run_config",
    "cli",
    "bench",
    "bench_parity",
    "bench_trials",
    "show",
    "terminal",
    "__init__",
    "__main__",
)
KERNELS = ROOT / "kernels" / "gmdx_kernels"


def imported(source: str, *, package: str) -> set[str]:
    """Modules that a source names in its imports, at any depth, type checking included."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.rsplit(".", node.level - 1)[0] if node.level else ""
            module = ".".join(filter(None, [base, node.module]))
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


def part(module: str) -> str | None:
    """`gmdx.scenes.camera` is of `scenes`; None for what is not gmdx."""
    words = module.split(".")
    return words[1] if words[0] == "gmdx" and len(words) > 1 else None


def allowed(home: str) -> set[str]:
    """What the modules of a part may import."""
    if home in COMPOSERS:
        return {*STAGES, *GROUND, *COMPOSERS}
    if home in GROUND:
        return set(GROUND)
    return {*STAGES[: STAGES.index(home) + 1], *GROUND}


def backward(path: Path) -> set[str]:
    """Imports of a module that run against the flow."""
    relative = path.relative_to(ROOT / "gmdx").with_suffix("")
    home, package = relative.parts[0], ".".join(["gmdx", *relative.parts[:-1]])
    parts = {part(module) for module in imported(path.read_text(), package=package)}
    known = {*STAGES, *GROUND, *COMPOSERS}
    return {p for p in parts if p in known and p not in allowed(home)}


MODULES = sorted((ROOT / "gmdx").rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_import_runs_back(path: Path) -> None:
    assert not backward(path)


def test_every_module_has_a_place() -> None:
    homes = {p.relative_to(ROOT / "gmdx").with_suffix("").parts[0] for p in MODULES}
    assert homes <= {*STAGES, *GROUND, *COMPOSERS}


def test_the_check_sees_what_runs_back() -> None:
    source = "def f():\n    from gmdx.trials import run\n    import gmdx.dataset.read\n"
    parts = {part(m) for m in imported(source, package="gmdx.scenes")}
    assert parts - {None} == {"trials", "dataset"}
    assert part(next(iter(imported("from ..trials import x", package="gmdx.scenes")))) == "trials"
    assert "trials" not in allowed("scenes")
    assert "config" in allowed("scenes")


def test_kernels_import_nothing_from_gmdx() -> None:
    for path in KERNELS.rglob("*.py"):
        if path.name.startswith("test_"):
            continue  # gmdx may judge what it does not help with
        names = imported(path.read_text(), package="gmdx_kernels")
        assert not {n for n in names if n.split(".")[0] == "gmdx"}, path


def test_importing_gmdx_is_free_of_heavy_packages() -> None:
    heavy = ("numpy", "mujoco", "jax", "scipy", "trimesh", "coacd", "pyarrow", "matplotlib")
    code = f"import sys, gmdx, gmdx.cli.main; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names_exist_and_are_listed() -> None:
    for name in gmdx.__all__:
        assert getattr(gmdx, name) is not None
    assert set(gmdx.__all__) <= set(dir(gmdx))
    wanted = {"load_object", "settle", "sample_grasps", "run_trials", "compute_metrics", "epsilon",
              "directional_strength", "generate", "read_dataset"}  # fmt: skip
    assert wanted <= set(gmdx.__all__)
    with pytest.raises(AttributeError, match="no attribute 'setle'"):
        gmdx.setle  # noqa: B018
