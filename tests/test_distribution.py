"""What is in the wheel and in the source archive, built here without a network."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "gmdx": ROOT / "gmdx",
    "gmdx_kernels": ROOT / "kernels" / "gmdx_kernels",
    "gmdx_assets": ROOT / "assets" / "gmdx_assets",
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    words = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(words, cwd=ROOT, capture_output=True, check=True)
    return folder


def test_the_wheel_holds_the_packages_and_nothing_else(built: Path) -> None:
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    present = {
        f"{package}/{path.relative_to(folder).as_posix()}"
        for package, folder in PACKAGES.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert names == present


def test_packages_are_typed_and_hold_no_tests() -> None:
    for folder in PACKAGES.values():
        assert (folder / "py.typed").is_file()
        modules = [path for path in folder.rglob("*.py") if "__pycache__" not in path.parts]
        assert not [path for path in modules if path.stem == "cases" or "test" in path.stem]
        source = "\n".join(path.read_text() for path in modules)
        assert "import pytest" not in source
        assert "from tests" not in source


def test_the_source_archive_can_be_tested(built: Path) -> None:
    """It has what the targets of the Makefile and the tests read."""
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"Makefile", "pyproject.toml", "constraints.txt", "README.md", "LICENSE"}
    wanted |= {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").glob("*.png")}
    wanted |= {
        path.relative_to(ROOT).as_posix()
        for folder in ("assets", "gmdx", "kernels", "notebooks", "tests")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".ipynb", ".md", ".toml", ".xml", ".obj")
    }
    assert wanted <= names
