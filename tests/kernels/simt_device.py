"""Device code on the emulator: the same sources, launched by the same runtime, through a driver that is played.

simt/simt.h says what it checks. The library is compiled once a session, in a temporary folder.
"""

import ctypes
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from splatree.kernels.cuda.driver import Device, Driver
from splatree.kernels.cuda.sources import ROOT, STAGES

SIMT = Path(__file__).parent / "simt"
FLAGS = ["-std=c++17", "-O1", "-fPIC", "-U_FORTIFY_SOURCE", "-Wall", "-Wextra", "-Werror"]
# Loops marked for a GPU's unrolling, and functions of headers that not every file uses.
FLAGS += ["-Wno-unknown-pragmas", "-Wno-unused-function", "-Wno-unused-variable"]


def compile_emulator(folder: Path) -> Path:
    """The emulator with all kernels as a library."""
    sources = [SIMT / "simt.cpp", SIMT / "faults.cu", *(ROOT / "cuda" / f"{stage}.cu" for stage in STAGES)]
    objects = [folder / f"{source.stem}.o" for source in sources]
    words = ["c++", *FLAGS, "-DSPLATREE_EMULATOR", f"-I{SIMT}", f"-I{ROOT}", "-x", "c++", "-c"]

    def compile_one(source: Path, target: Path) -> None:
        subprocess.run([*words, str(source), "-o", str(target)], check=True)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(compile_one, sources, objects))
    library = folder / "libsimt.so"
    subprocess.run(["c++", "-shared", *map(str, objects), "-o", str(library), "-ldl"], check=True)
    return library


class Emulator(Device):
    """The emulator as a device."""

    def __init__(self, library: Path) -> None:
        self.library = ctypes.CDLL(str(library))
        self.library.simt_waits.restype = ctypes.c_longlong
        self.library.simt_launches.restype = ctypes.c_longlong
        super().__init__(Driver(self.library), lambda stage, architecture: b"")

    @property
    def num_waits(self) -> int:
        """Times the host has waited for the device."""
        return int(self.library.simt_waits())

    @property
    def num_launches(self) -> int:
        """Kernels run."""
        return int(self.library.simt_launches())

    def seed(self, value: int) -> None:
        """Choose the order in which threads and blocks run."""
        self.library.simt_seed(ctypes.c_uint32(value))

    def limit_memory(self, num_bytes: int) -> None:
        """Choose how much memory there is."""
        self.library.simt_limit_memory(ctypes.c_size_t(num_bytes))

    def forget_failure(self) -> None:
        """Go on after a launch that failed."""
        self.library.simt_forget_failure()

    def add_kernel(self, name: str, threads: int) -> None:
        """Make a kernel that is not part of the package known to `launch`."""
        self._kernels[name] = ctypes.c_void_p(ctypes.cast(getattr(self.library, name), ctypes.c_void_p).value), threads

    def _allocate(self, num_bytes: int, name: str) -> int:
        pointer = super()._allocate(num_bytes, name)
        self.library.simt_name(ctypes.c_uint64(pointer), name.encode())
        return pointer
