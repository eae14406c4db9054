"""``splatree check``: a line for each scene that is whole, an error for the first that is not."""

import json

from splatree.io.reading import read_levels


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


def test_every_level_of_a_stream_is_checked(splatree, small_tree, tmp_path):
    stream = tmp_path / "stream"
    assert splatree("stream", small_tree, stream, "--quiet")[0] == 0
    (whole,) = json.loads(splatree("check", stream, "--json")[1])["scenes"]
    levels = read_levels(stream)
    assert len(levels) > 2 and whole["num_gaussians"] == len(levels[0])
    assert whole["num_nodes"] == sum(map(len, levels))
    part = next(stream.glob("2_0-*"))
    (part / "means_l.webp").write_bytes(b"damaged")
    code, _, err = splatree("check", stream)
    assert code == 1 and f"{part.name}/meta.json: means_l.webp: not a whole WebP" in err


def test_every_tile_is_checked_and_coarser_ones_are_told_apart(splatree, small_tree, tmp_path):
    tiles = tmp_path / "tiles"
    words = ("--format", "3dtiles", "--tile-nodes", "500", "--quiet")
    assert splatree("stream", small_tree, tiles, *words)[0] == 0
    code, out, _ = splatree("check", tiles)
    assert code == 0 and "3d-tiles" in out and " of coarser tiles, " in out
    gone = [path.name for path in sorted(tiles.glob("*.glb"))[:2]]
    for name in gone:
        (tiles / name).unlink()
    code, _, err = splatree("check", tiles)
    assert code == 1 and "found 2 of its tiles damaged or missing" in err and all(name in err for name in gone)
