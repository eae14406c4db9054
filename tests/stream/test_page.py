"""What the page makes of its address, in Node instead of a browser."""

import shutil
import subprocess
from importlib.resources import files

import pytest

NODE = shutil.which("node")
READ = """
Object.assign(globalThis, { location: { href: process.argv[2] }, window: {} });
const { dilation } = await import(process.argv[1]);
console.log(dilation);
"""


@pytest.fixture(scope="module")
def query(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "query.mjs"
    path.write_bytes((files("splatree.stream") / "page" / "query.js").read_bytes())
    return path


@pytest.mark.skipif(NODE is None, reason="node is not installed")
@pytest.mark.parametrize(
    ("asked", "expected"),
    [("", 0.3), ("&dilation=0.075", 0.075), ("&dilation=0", 0), ("&dilation=abc", 0.3), ("&dilation=", 0.3)]
    + [("&dilation=-1", 0.3), ("&dilation=Infinity", 0.3)],
)
def test_a_dilation_that_is_no_number_is_the_usual_one(query, asked, expected):
    words = [NODE, "--input-type=module", "-e", READ, query.as_uri(), f"http://here/page/?stream=city{asked}"]
    said = subprocess.run(words, capture_output=True, text=True, check=True)
    assert float(said.stdout) == expected
