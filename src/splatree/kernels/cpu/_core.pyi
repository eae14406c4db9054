# The compiled module, for type checkers: signatures are in bind_*.cpp, types are checked by the glue beside this file.
from typing import Any

def __getattr__(name: str) -> Any: ...
