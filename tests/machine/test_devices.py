import subprocess
import sys

import pytest

from gmdx.errors import ConfigError
from gmdx.machine.devices import check_implementation, on_device


def _asked(code: str) -> str:
    """What code prints in a process of its own."""
    words = [sys.executable, "-c", code]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


def test_auto_is_numpy_without_asking_jax() -> None:
    code = "import sys; from gmdx.machine.devices import implementation, on_device\n"
    code += "print(on_device(implementation('auto')), 'jax' in sys.modules)"
    assert _asked(code) == "numpy False"


def test_records_name_what_jax_computes_on() -> None:
    assert on_device("jax") == f"jax ({_asked('import jax; print(jax.default_backend())')})"


def test_an_unknown_implementation_is_refused() -> None:
    check_implementation("auto", ("numpy",), kernel="lines")
    with pytest.raises(ConfigError, match=r"lines has no implementation 'cuda'.*auto, numpy, jax"):
        check_implementation("cuda", ("numpy", "jax"), kernel="lines")
