"""Device code on the emulator: the same sources, launched by the same runtime, through a driver that is played.

simt/simt.h says what it checks. The library is compiled once a session, in a temporary folder.
"""

import ctypes
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.library import Driver, Handle
from splatree.kernels.cuda.sources import ROOT, STAGES, kernels_of

SIMT = Path(__file__).parent / "simt"
FLAGS = ["-std=c++17", "-O1", "-fPIC", "-U_FORTIFY_SOURCE", "-Wall", "-Wextra", "-Werror"]
# Loops marked for a GPU's unrolling, and functions of headers that not every file uses.
FLAGS += ["-Wno-unknown-pragmas", "-Wno-unused-function", "-Wno-unused-variable"]


def compile_emulator(folder: Path) -> Path:
    """The emulator with all kernels as a library."""
    sources = [
        SIMT / "simt.cpp",
        SIMT / "driver.cpp",
        SIMT / "faults.cu",
        *(ROOT / "cuda" / f"{stage}.cu" for stage in STAGES),
    ]
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
        for count in ("waits", "launches", "allocations"):
            getattr(self.library, f"simt_{count}").restype = ctypes.c_longlong
        self.library.simt_other_context.restype = ctypes.c_void_p
        driver = Driver(self.library)
        driver("cuInit", 0)
        super().__init__(driver, lambda stage, architecture: image_of(kernels_of(stage)))

    @property
    def num_waits(self) -> int:
        """Times the host has waited for the device, or may have had to."""
        return int(self.library.simt_waits())

    @property
    def num_launches(self) -> int:
        """Kernels run."""
        return int(self.library.simt_launches())

    @property
    def num_allocations(self) -> int:
        """Arrays ever asked for, in device memory and pinned."""
        return int(self.library.simt_allocations())

    @property
    def held(self) -> dict[str, int]:
        """What the host holds."""
        counts = (ctypes.c_longlong * 4)()
        self.library.simt_held(counts)
        return dict(zip(("arrays", "pinned", "events", "graphs"), counts, strict=True))

    def seed(self, value: int) -> None:
        """Choose the order in which threads and blocks run."""
        self.library.simt_seed(ctypes.c_uint32(value))

    def interleave(self, num_resident: int) -> None:
        """Choose how many blocks take turns; 1: they run one after the other."""
        self.library.simt_interleave(ctypes.c_uint(num_resident))

    def limit_memory(self, num_bytes: int) -> None:
        """Choose how much memory there is."""
        self.library.simt_limit_memory(ctypes.c_size_t(num_bytes))

    def play(self, *, version: int = 13000, devices: int = 1, major: int = 9, minor: int = 0, init: int = 0) -> None:
        """Choose what machine it is: CUDA version of the driver, GPUs, compute capability, what cuInit says."""
        self.library.simt_machine(version, devices, major, minor, init)

    def forget_failure(self) -> None:
        """Go on after a launch that failed."""
        self.library.simt_forget_failure()

    def add_kernel(self, name: str, threads: int) -> None:
        """Make a kernel that is not part of the package known to `launch`."""
        module, function = Handle(), Handle()
        self.call("cuModuleLoadData", ctypes.byref(module), image_of({name: threads}))
        self.call("cuModuleGetFunction", ctypes.byref(function), module, name.encode())
        self._kernels[name] = function, threads

    def _allocate(self, num_bytes: int, name: str) -> int:
        pointer = super()._allocate(num_bytes, name)
        self.library.simt_name(ctypes.c_uint64(pointer), name.encode())
        return pointer


def image_of(kernels: dict[str, int]) -> bytes:
    """A module of the stand-in: its kernels, with the threads of a block."""
    return ("SIMT\n" + "\n".join(f"{name} {threads}" for name, threads in kernels.items())).encode()
