"""Packages whose version can change a result, and which versions of them are installed."""

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

# Of prepared objects.
PREPARING = ("coacd", "fast-simplification", "manifold3d", "numpy", "scipy", "trimesh")
# Of everything that comes of them: a dataset or a study is made with one version of each.
RESULTS = ("gmdx", *PREPARING, "clarabel", "mujoco", "pyarrow")
_KERNELS = {"jax": ("jax", "jaxlib")}


def versions(packages: Iterable[str]) -> dict[str, str]:
    """The installed versions, by package.

    Raises:
        PackageNotFoundError: One is not installed.
    """
    return {package: version(package) for package in packages}


def versions_installed(packages: Iterable[str]) -> dict[str, str]:
    """The same of those that are installed."""
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def kernel_packages(implementation: str) -> tuple[str, ...]:
    """Packages that an implementation of array kernels rests on, besides those of every result."""
    return _KERNELS.get(implementation, ())
