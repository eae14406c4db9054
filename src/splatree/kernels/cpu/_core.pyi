# The compiled module, for type checkers: signatures are in bind_*.cpp, types are checked by the glue beside this file.
"""The compiled module; the glue files of this package give its functions their types."""

from typing import Any

def __getattr__(name: str) -> Any: ...
