"""``splatree check``: a line for each scene that is whole, an error for the first that is not."""

import json


def test_what_is_whole_is_said_to_be(splatree, small_ply, small_tree):
    code, out, err = splatree("check", small_ply, small_tree)
    assert code == 0, err
    first, second = out.splitlines()
    assert first.startswith(f"whole: {small_ply}, ply, ")
    assert "merged nodes" in second
    assert len(json.loads(splatree("check", small_tree, "--json")[1])["scenes"]) == 1


def test_what_is_damaged_is_named(splatree, small_tree, tmp_path):
    damaged = tmp_path / "damaged.splatree"
    damaged.write_bytes(small_tree.read_bytes()[:-7])
    code, _, err = splatree("check", small_tree, damaged)
    assert code == 1
    assert "damaged.splatree" in err
    assert "cut off" in err
