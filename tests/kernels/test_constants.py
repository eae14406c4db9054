"""The numbers that the kernels share with Python are generated, not retyped."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "constants"


@pytest.mark.skipif(not SCRIPT.exists(), reason="the scripts of the repository are not here")
def test_the_header_of_constants_is_up_to_date():
    subprocess.run([sys.executable, str(SCRIPT), "--check"], check=True)
