from ..kernels.conftest import view

__all__ = ["view"]
