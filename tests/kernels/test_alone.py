"""The kernels, and the tests of theirs in this folder, do without gmdx."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def _modules(package: Path, base: Path) -> list[str]:
    paths = [path.relative_to(base).with_suffix("") for path in package.rglob("*.py")]
    return sorted(".".join(path.parts).removesuffix(".__init__") for path in paths)


def test_kernels_and_their_tests_are_imported_without_gmdx() -> None:
    kernels = ROOT / "kernels"
    modules = _modules(kernels / "gmdx_kernels", kernels) + _modules(ROOT / "tests/kernels", ROOT)
    assert "tests.kernels.epsilon.cases" in modules
    code = "import sys; sys.modules['gmdx'] = None; "  # so that importing it fails
    code += "; ".join(f"import {module}" for module in modules)
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
