"""Without what an engine or kernel needs: one line that says what to install; `auto` falls back."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(params=["warp", "mjx", "jax"])
def missing(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def site(missing: str, tmp_path: Path) -> Path:
    """What is installed here, less one package."""
    import mujoco

    if missing == "warp":
        pytest.importorskip("warp", reason="the extra gmdx[warp] is not installed")
    installed = Path(mujoco.__file__).parents[1]
    site = tmp_path / "site"
    site.mkdir()
    for entry in installed.iterdir():
        if entry.suffix == ".pth" or entry.name == "mujoco":
            continue
        if entry.name.split("-")[0] not in _folders(missing):
            (site / entry.name).symlink_to(entry)
    (site / "mujoco").mkdir()
    for entry in (installed / "mujoco").iterdir():
        if not (entry.name == "mjx" and missing == "mjx"):
            (site / "mujoco" / entry.name).symlink_to(entry)
    return site


def _folders(missing: str) -> tuple[str, ...]:
    return {"warp": ("warp", "warp_lang"), "mjx": ("mujoco_mjx",), "jax": ("jax", "jaxlib")}[
        missing
    ]


def _python(site: Path, code: str) -> subprocess.CompletedProcess[str]:
    """Run code that sees nothing of the environment but `site` and this project."""
    paths = [site, ROOT, ROOT / "kernels", ROOT / "assets"]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}
    words = [sys.executable, "-S", "-c", code]
    return subprocess.run(words, env=env, capture_output=True, text=True, check=False, cwd=site)


@pytest.mark.parametrize("missing", ["warp", "mjx"], indirect=True)
def test_a_missing_package_is_named(missing: str, site: Path) -> None:
    done = _python(
        site,
        "from gmdx.trials.engines.registry import open_engine\n"
        "from gmdx.errors import UsageError\n"
        "try: open_engine('warp')\n"
        "except UsageError as error: print(error)\n",
    )
    assert done.returncode == 0, done.stderr
    name = {"warp": "warp-lang", "mjx": "mujoco-mjx"}[missing]
    expected = f"engine 'warp' needs {name}: pip install 'gmdx[warp]'"
    assert done.stdout.count("\n") == 1
    assert expected in done.stdout


def test_auto_falls_back(site: Path) -> None:
    done = _python(
        site,
        "from gmdx.trials.engines.registry import choose, open_engine\n"
        "print(choose('auto'), type(open_engine('auto')).__name__)\n",
    )
    assert done.stdout.split() == ["mujoco", "MujocoEngine"], done.stderr


def test_array_kernels_name_a_missing_jax(missing: str, site: Path) -> None:
    code = (
        "from gmdx.machine.devices import implementation\n"
        "print(implementation('auto'))\n"
        "print(implementation('jax'))\n"
    )
    done = _python(site, code)
    if missing == "jax":
        assert done.stdout.split() == ["numpy"]
        assert "needs jax: pip install 'gmdx[jax]'" in done.stderr.splitlines()[-1]
    else:
        assert done.stdout.split() == ["numpy", "jax"]
