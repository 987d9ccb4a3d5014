import subprocess
import sys

import pytest

from gmdx.errors import ConfigError
from gmdx.machine.devices import accelerator, check_implementation, implementation, on_device


def test_the_accelerator_is_what_jax_computes_on() -> None:
    """Asked of JAX itself, in a process of its own."""
    code = "import jax; print(jax.default_backend())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    platform = done.stdout.strip()
    assert accelerator() == (None if platform == "cpu" else platform)


def test_auto_stands_for_what_suits_the_machine() -> None:
    expected = "numpy" if accelerator() is None else "jax"
    assert implementation("auto", cpu="numpy") == expected
    assert implementation("embree", cpu="numpy") == "embree"
    check_implementation("auto", ("numpy",), kernel="lines")
    with pytest.raises(ConfigError, match=r"lines has no implementation 'cuda'.*auto, numpy, jax"):
        check_implementation("cuda", ("numpy", "jax"), kernel="lines")


def test_an_accelerator_asks_for_jax(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gmdx.machine.devices.accelerator", lambda: "gpu")
    assert implementation("auto", cpu="numpy") == "jax"
    assert implementation("numpy", cpu="numpy") == "numpy"
    assert [on_device(name) for name in ("jax", "numpy")] == ["jax (gpu)", "numpy"]
