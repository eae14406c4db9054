"""The structs that kernels take, from Python: addresses and sizes by name, and before those of a frame the numbers of its view,
which the native core packs.

Names, order and types of the arrays are read from the headers. The driver compiles these headers at run time, so no compiler of
the package's build could export the structs, and a second list of fifty fields in Python would drift from the first.
tests/kernels/test_cuda_compile.py checks that no field is overlooked.
"""

import re
from collections.abc import Mapping
from functools import cache

import numpy as np

from splatree.errors import InputError
from splatree.kernels.cpu import _core
from splatree.kernels.cpu.frame.question import pack_question, pack_sides
from splatree.kernels.cpu.frame.view import pack_square
from splatree.kernels.cuda.sources import headers
from splatree.scene.options import SelectOptions
from splatree.scene.view import View

__all__ = ["COUNTERS", "array_dtypes", "fields_of", "pack_fields", "pack_job", "pack_numbers"]

_DTYPES = {
    "double": (np.float64, 1),
    "float": (np.float32, 1),
    "float4": (np.float32, 4),
    "int": (np.int32, 1),
    "int4": (np.int32, 4),
    "unsigned": (np.uint32, 1),
    "unsigned short": (np.uint16, 1),
    "unsigned char": (np.uint8, 1),
    "unsigned long long": (np.uint64, 1),
}

_FRAME = ("cuda/job.h", "FrameJob")


@cache
def fields_of(header: str, struct: str) -> tuple[tuple[tuple[str, str], ...], tuple[str, ...]]:
    """Arrays of a struct with their types, and its sizes, in their order."""
    body = headers()[header].split(f"struct {struct} {{")[1]
    arrays = re.findall(r"^  Global<(?:const )?([\w ]+)> (\w+);", body, re.M)
    return tuple((name, kind) for kind, name in arrays), tuple(re.findall(r"^  long long (\w+);", body, re.M))


@cache
def _counters() -> tuple[str, ...]:
    body = re.search(r"enum Counter \{(.*?)\};", headers()["cuda/job.h"], re.S)
    assert body is not None
    return tuple(name.lower() for name in re.findall(r"^  (NUM_\w+),", body[1], re.M))


COUNTERS = _counters()
"""Names of the counters, in their order: num_selected, num_pairs, ..."""


def array_dtypes() -> dict[str, tuple[np.dtype[np.generic], int]]:
    """Type and number of values of an element of each array of a job."""
    return {name: (np.dtype(_DTYPES[kind][0]), _DTYPES[kind][1]) for name, kind in fields_of(*_FRAME)[0]}


def pack_job(numbers: bytes, pointers: Mapping[str, int], sizes: Mapping[str, int]) -> np.ndarray:
    """The bytes of a frame's job; arrays that are not named have no memory, sizes that are not named are 0."""
    return np.frombuffer(numbers + pack_fields(*_FRAME, pointers, sizes).tobytes(), np.uint8)


def pack_fields(header: str, struct: str, pointers: Mapping[str, int], sizes: Mapping[str, int]) -> np.ndarray:
    """The bytes of a struct of arrays and sizes; those that are not named are 0."""
    arrays, fields = fields_of(header, struct)
    unknown = sorted((pointers.keys() - {name for name, _ in arrays}) | (sizes.keys() - set(fields)))
    assert not unknown, unknown
    words = [pointers.get(name, 0) for name, _ in arrays] + [sizes.get(name, 0) for name in fields]
    return np.array(words, np.int64).view(np.uint8)


def pack_numbers(view: View, select: SelectOptions, *, degree: int, whole_box: bool = False) -> bytes:
    """The struct FrameNumbers of a view."""
    if select.rule != "cut" or select.max_radius is not None:
        found = f"rule {select.rule!r}" if select.rule != "cut" else f"max_radius {select.max_radius}"
        raise InputError(
            f"device 'cuda': found {found}, wanted rule 'cut' without max_radius; use device 'cpu' for others"
        )
    question = pack_question(view, select)
    sides = pack_sides(view, select, question.view)
    numbers = _core.frame_numbers(question, sides, view, min(view.sh_degree, degree), pack_square(view), whole_box)
    return bytes(numbers)
