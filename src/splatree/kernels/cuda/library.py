"""The CUDA driver's library through ctypes: its functions with checked arguments, its errors with advice.

It comes with every GPU driver and has had these functions, with these signatures, since CUDA 11.4: driver.h declares them, and
their types are read from there. Nothing else is needed on the machine, neither a toolkit nor torch.

Why not cuda.core (1.2), which has all of it: its packages take 48 MB and half a second to load, and look up every function
of the driver through cuGetProcAddress, which a stand-in for the tests would have to play whole. What it would save is this
file's table and a few lines in each class of driver.py. These are forty functions.
"""

import ctypes
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

from splatree.errors import DeviceError

__all__ = ["NUMBERS", "Address", "Driver", "Handle", "dotted", "load_driver"]

LIBRARY_NAMES = {"win32": ("nvcuda.dll",)}.get(sys.platform, ("libcuda.so.1", "libcuda.so"))
OLDEST_DRIVER = 11040
"""CUDA 11.4 (2021) is the first whose driver instantiates graphs by the function used here."""

Handle = ctypes.c_void_p
Address = ctypes.c_uint64

_HEADER = (Path(__file__).parent / "driver.h").read_text(encoding="utf-8")
NUMBERS = {name: int(value) for name, value in re.findall(r"^  (CU\w+) = (\d+),", _HEADER, re.M)}
"""Numbers of cuda.h by name."""
_TYPES = {
    "int": ctypes.c_int,
    "unsigned": ctypes.c_uint,
    "unsigned char": ctypes.c_ubyte,
    "unsigned long long": ctypes.c_uint64,
    "size_t": ctypes.c_size_t,
    "float": ctypes.c_float,
    "char*": ctypes.c_char_p,
    "void*": ctypes.c_void_p,
    "CUdeviceptr": Address,
    "CUdevice": ctypes.c_int,
    "CUresult": ctypes.c_int,
    "CUdevice_attribute": ctypes.c_int,
    "CUstreamCaptureMode": ctypes.c_int,
    "CUpointer_attribute": ctypes.c_int,
}
_ADVICE = {
    "CUDA_ERROR_OUT_OF_MEMORY": "draw with fewer or smaller arrays, or free GPU memory",
    "CUDA_ERROR_STUB_LIBRARY": "this is the stub of a toolkit: install the NVIDIA driver, or take the stub off the path",
    "CUDA_ERROR_NO_DEVICE": "attach a GPU, in a container pass it through (--gpus all), or use device 'cpu'",
    "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH": "the driver was updated: restart the machine",
}


@cache
def prototypes() -> dict[str, list[Any]]:
    """Types of the arguments of each function."""
    functions = re.findall(r"^CUresult (\w+)\((.*?)\);", _HEADER, re.M | re.S)
    return {name: [_type(argument) for argument in arguments.split(",")] for name, arguments in functions}


def _type(declared: str) -> Any:
    """The type of ``const char** name``; what is not listed is a handle."""
    kind = declared.replace("const ", "").strip().rpartition(" ")[0]
    if kind in _TYPES:
        return _TYPES[kind]
    return ctypes.POINTER(_type(f"{kind[:-1]} x")) if kind.endswith("*") else Handle


class Driver:
    """The functions of the driver's library, with its errors as `DeviceError`."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._functions = {}
        for name, types in prototypes().items():
            try:
                function = self._functions[name] = getattr(library, name)
            except AttributeError as error:
                wanted = dotted(OLDEST_DRIVER)
                raise DeviceError(
                    f"GPU driver: found no {name}, wanted a driver for CUDA {wanted} or newer; update it"
                ) from error
            function.argtypes = types

    def __call__(self, name: str, *arguments: Any) -> None:
        """Call a function; an error says what the driver says, and what to do where that is known."""
        code = self.result_of(name, *arguments)
        if code:
            raise self.error(name, code)

    def result_of(self, name: str, *arguments: Any) -> int:
        """Call a function; what it returned."""
        return int(self._functions[name](*arguments))

    def version(self) -> int:
        """1000 × major + 10 × minor of the CUDA version that the driver supports."""
        found = ctypes.c_int()
        self("cuDriverGetVersion", ctypes.byref(found))
        return found.value

    def error(self, function: str, code: int) -> DeviceError:
        """What a function has returned, in words."""
        name, text = ctypes.c_char_p(), ctypes.c_char_p()
        self.result_of("cuGetErrorName", code, ctypes.byref(name))
        self.result_of("cuGetErrorString", code, ctypes.byref(text))
        known = (name.value or b"unknown error").decode()
        advice = f"; {_ADVICE[known]}" if known in _ADVICE else ""
        return DeviceError(f"GPU driver, {function}: {known} ({code}): {(text.value or b'').decode()}{advice}")


def load_driver() -> Driver:
    """The driver of this machine, initialised.

    Raises:
        DeviceError: there is none, it is too old, or it finds no GPU.
    """
    for name in LIBRARY_NAMES:
        try:
            driver = Driver(ctypes.CDLL(name))
            break
        except OSError:
            continue
    else:
        raise DeviceError(
            f"no GPU driver: {LIBRARY_NAMES[0]} was not found; install the NVIDIA driver, or use device 'cpu'"
        )
    version = driver.version()
    if version < OLDEST_DRIVER:
        raise DeviceError(
            f"GPU driver: found CUDA {dotted(version)}, wanted at least {dotted(OLDEST_DRIVER)}; update it"
        )
    driver("cuInit", 0)
    return driver


def dotted(version: int) -> str:
    """13000 as "13.0"."""
    return f"{version // 1000}.{version % 1000 // 10}"
