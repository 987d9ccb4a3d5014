"""Under test, every shape annotation of gmdx and its kernels is enforced."""

from jaxtyping import install_import_hook

install_import_hook(["gmdx", "gmdx_kernels"], "beartype.beartype")
