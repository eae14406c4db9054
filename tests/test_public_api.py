import inspect
import subprocess
import sys

import splatree


def test_public_names_are_sorted_and_complete():
    assert splatree.__all__ == sorted(splatree.__all__)
    imported = {
        name for name, value in vars(splatree).items() if not name.startswith("_") and not inspect.ismodule(value)
    }
    assert imported == set(splatree.__all__)


def test_public_names_say_what_they_are():
    silent = [name for name in splatree.__all__ if not inspect.getdoc(getattr(splatree, name))]
    assert silent == []


def test_import_loads_nothing_heavy():
    heavy = ("PIL", "rich", "safetensors", "torch", "tyro", "imageio_ffmpeg", "splatree.cli")
    code = f"import sys, splatree; print(*(name for name in {heavy} if name in sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
