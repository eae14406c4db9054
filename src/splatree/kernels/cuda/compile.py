"""Compile device code with NVRTC for the GPU at hand, and keep the result on disk.

NVRTC is a library of 60 MB (``pip install 'splatree[cuda]'``, or what torch or a toolkit brought); it needs neither a toolkit
nor a driver, and takes 0.1 to 0.3 s a file. What it makes runs on any driver of its CUDA major version or a later one.

The cache is a file a stage, named by a digest of all that the result depends on: source, headers, options, architecture, the
compiler's and the driver's version. Files are written beside and renamed, so that processes which compile at once do not
disturb each other, and carry a digest of their content: one that is damaged is compiled anew.
"""

import ctypes
import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from splatree.errors import DeviceError
from splatree.kernels.cuda.sources import headers, source

__all__ = ["CACHE", "Compiler", "find_compilers", "load_compiler"]

CACHE = Path("~/.cache/splatree/cuda")
"""Where compiled kernels are kept; it may be deleted at any time."""
OPTIONS = ("--std=c++17",)
OLDEST = (11, 8)
"""NVRTC 11.8 is the first that knows Ada and Hopper."""
_DIGEST_BYTES = 32


@dataclass(frozen=True)
class Compiled:
    """What NVRTC made of a file."""

    cubin: bytes
    """Machine code of one architecture."""
    log: str
    """What it said."""


class Compiler:
    """NVRTC."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._library = ctypes.CDLL(path)
        major, minor = ctypes.c_int(), ctypes.c_int()
        self._check(self._library.nvrtcVersion(ctypes.byref(major), ctypes.byref(minor)), "version")
        self.version = major.value, minor.value

    def compile(self, stage: str, architecture: str, *options: str) -> Compiled:
        """Compile a file of kernels.

        Raises:
            DeviceError: with the compiler's messages.
        """
        program = ctypes.c_void_p()
        names, texts = zip(*headers().items(), strict=True)
        array = ctypes.c_char_p * len(names)
        self._check(
            self._library.nvrtcCreateProgram(
                ctypes.byref(program),
                source(stage).encode(),
                f"{stage}.cu".encode(),
                ctypes.c_int(len(names)),
                array(*(text.encode() for text in texts)),
                array(*(name.encode() for name in names)),
            ),
            stage,
        )
        try:
            words = [word.encode() for word in (f"--gpu-architecture={architecture}", *OPTIONS, *options)]
            code = self._library.nvrtcCompileProgram(
                program, ctypes.c_int(len(words)), (ctypes.c_char_p * len(words))(*words)
            )
            log = self._text(program, "ProgramLog").rstrip(b"\0").decode(errors="replace")
            if code:
                raise DeviceError(
                    f"NVRTC {self._dotted()}: {stage}.cu does not compile for {architecture}:\n{log.strip()}"
                )
            return Compiled(self._text(program, "CUBIN"), log)
        finally:
            self._library.nvrtcDestroyProgram(ctypes.byref(program))

    def cubin_of(self, stage: str, architecture: str, driver_version: int, *, cache: Path | None = CACHE) -> bytes:
        """The machine code of a file of kernels, from the cache if it is there."""
        key = hashlib.sha256()
        parts = [
            source(stage),
            *map(str, headers().items()),
            *OPTIONS,
            architecture,
            str(self.version),
            str(driver_version),
        ]
        for part in parts:
            key.update(len(part).to_bytes(8, "little") + part.encode())
        path = cache.expanduser() / f"{stage}_{architecture}_{key.hexdigest()[:32]}.cubin" if cache else None
        kept = _read(path) if path else None
        if kept is not None:
            return kept
        cubin = self.compile(stage, architecture).cubin
        if path:
            _write(path, cubin)
        return cubin

    def _text(self, program: ctypes.c_void_p, what: str) -> bytes:
        size = ctypes.c_size_t()
        self._check(getattr(self._library, f"nvrtcGet{what}Size")(program, ctypes.byref(size)), what)
        text = ctypes.create_string_buffer(size.value)
        self._check(getattr(self._library, f"nvrtcGet{what}")(program, text), what)
        return text.raw

    def _check(self, code: int, what: str) -> None:
        if code:
            get_text = self._library.nvrtcGetErrorString
            get_text.restype = ctypes.c_char_p
            raise DeviceError(f"NVRTC ({self.path}), {what}: {get_text(code).decode()}")

    def _dotted(self) -> str:
        return ".".join(map(str, self.version))


def find_compilers() -> Iterator[str]:
    """Libraries to try: those of Python packages, newest first, then what the system finds."""
    windows = sys.platform == "win32"
    pattern = "**/nvrtc64_*_0.dll" if windows else "*/lib/libnvrtc.so.*"
    spec = importlib.util.find_spec("nvidia")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    packaged = [path for folder in folders for path in Path(folder).glob(pattern) if "alt" not in path.name]
    yield from map(str, sorted(packaged, key=lambda path: _number(path.name), reverse=True))
    yield from (
        ("nvrtc64_130_0.dll", "nvrtc64_120_0.dll") if windows else ("libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so")
    )


def load_compiler(driver_version: int | None = None) -> Compiler:
    """The newest NVRTC that the driver can follow: of its major CUDA version or an older one.

    Raises:
        DeviceError: there is none.
    """
    found = []
    for path in find_compilers():
        try:
            compiler = Compiler(path)
        except OSError:
            continue
        if compiler.version >= OLDEST and (driver_version is None or compiler.version[0] <= driver_version // 1000):
            return compiler
        found.append(f"{compiler._dotted()} ({path})")
    if not found:
        raise DeviceError("no NVRTC, the compiler of CUDA: pip install 'splatree[cuda]'")
    assert driver_version is not None
    major = driver_version // 1000
    package = f"nvidia-cuda-nvrtc-cu{major}" if major < 13 else "'nvidia-cuda-nvrtc<14'"
    raise DeviceError(
        f"NVRTC: found {', '.join(found)}, wanted {OLDEST[0]}.{OLDEST[1]} to {major}.x, as the driver supports CUDA {major}: "
        f"update the driver, or pip install {package}"
    )


def _number(name: str) -> int:
    return int("".join(filter(str.isdigit, name)) or 0)


def _read(path: Path) -> bytes | None:
    """The content of a file of the cache; None if it is not there or damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, cubin = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    return cubin if hashlib.sha256(cubin).digest() == digest else None


def _write(path: Path, cubin: bytes) -> None:
    """Keep a file in the cache; a folder that cannot be written only means to compile again next time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, beside = tempfile.mkstemp(dir=path.parent, prefix=path.name)
    except OSError:
        return
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(hashlib.sha256(cubin).digest() + cubin)
        Path(beside).replace(path)
    except OSError:
        Path(beside).unlink(missing_ok=True)
