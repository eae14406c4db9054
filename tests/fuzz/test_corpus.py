"""The stored corpus and the seeds of the fuzzers, each as it is and changed: scenes that can be drawn, or errors of ours.

It needs no fuzzer, so it runs everywhere, and on the core with sanitizers in `scripts/sanitize`.
"""

import random
from functools import partial

import pytest

from .kinds import CORPUS, all_kinds, seeds_of, stored_inputs, target_of
from .reading import read_once, through_compression, with_odd_number

CHANGES = 2
"""Changes of each input; each is another one."""


@pytest.mark.parametrize("kind", all_kinds())
def test_stored_inputs_and_changes_of_them_are_read_or_refused(kind, tmp_path):
    seeds = seeds_of(kind, tmp_path)
    target = target_of(seeds, tmp_path)
    inputs = [seed.read_bytes() for seed in seeds] + stored_inputs(kind)
    for number, data in enumerate(inputs):
        read_once(target, data)
        numbers = random.Random(number)
        for _ in range(CHANGES):
            read_once(target, through_compression(data, partial(with_odd_number, numbers=numbers)))


def test_the_corpus_is_small_and_of_known_kinds():
    files = list(CORPUS.iterdir())
    assert {path.stem for path in files} <= set(all_kinds())
    assert sum(path.stat().st_size for path in files) < 300_000
