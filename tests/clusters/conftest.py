from ..kernels.conftest import isa, view

__all__ = ["isa", "view"]
