"""Each verb from end to end on a small real scene."""

import gzip
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatree.cli.pictures import file_names
from splatree.io.cameras.files import write_cameras
from splatree.io.images import read_image, write_image
from splatree.io.options import WriteOptions
from splatree.io.reading import read
from splatree.io.writing import write
from splatree.outofcore.needs import Needs
from splatree.render.calibration import METADATA_KEY
from splatree.render.paths import PathOptions, flyout, orbit
from splatree.render.pipeline import render
from splatree.scene.cameras import Camera, Cameras
from splatree.scene.options import SelectOptions
from splatree.scene.scene import Scene

NUM_GAUSSIANS = 3161

SIZE = ("--width", "64", "--height", "36")


def result_of(run):
    code, out, err = run
    assert (code, err) == (0, "")
    return json.loads(out)


def test_info_counts_and_places_the_scene(splatree, small_tree):
    info = result_of(splatree("info", small_tree, "--json"))
    scene = read(small_tree)
    assert info["num_gaussians"] == NUM_GAUSSIANS
    assert info["num_nodes"] == len(scene) > NUM_GAUSSIANS
    assert info["levels"] == scene.tree.num_levels == len(info["nodes_per_depth"])
    assert (info["record"]["rule"], info["record"]["profile"]) == ("radius-thinning", "pixel")
    assert info["record"]["steps"] == list(scene.tree.record.steps)
    assert sum(info["nodes_per_depth"]) == info["num_nodes"]
    assert info["sh_degree"] == 3
    assert info["box_min"] == [float(x) for x in scene.gaussians.means[scene.tree.is_leaf].min(axis=0)]
    assert 0 < info["opacity"]["median"] < 1
    code, words, _ = splatree("info", small_tree)
    assert code == 0
    assert "3,161" in words


@pytest.mark.parametrize("flat", [True, False])
def test_build_makes_clusters(splatree, small_ply, tmp_path, flat):
    words = ("--clusters", "50", *(["--flat"] if flat else []))
    built = result_of(splatree("build", small_ply, tmp_path / "a.splatree", *words, "--json"))
    assert (built["rules"] is None) == flat
    assert built["clusters"]["rule"] == ("kmeans" if flat else "subtrees")
    info = result_of(splatree("info", tmp_path / "a.splatree", "--json"))
    assert info["clusters"]["number"] == built["clusters"]["clusters"]
    code, words, _ = splatree("info", tmp_path / "a.splatree")
    assert code == 0
    assert f"{info['clusters']['number']}, median of" in words


def test_clusters_are_made_through_files_where_that_is_asked_for_or_memory_is_short(
    splatree, small_ply, small_tree, tmp_path, monkeypatch
):
    words = ("--flat", "--clusters", "50")
    for scene in (small_ply, small_tree):
        assert splatree("build", scene, tmp_path / "memory.splatree", *words, "--force", "-q")[0] == 0
        wanted = (tmp_path / "memory.splatree").read_bytes()
        done = result_of(
            splatree("build", scene, tmp_path / "a.splatree", *words, "--max-memory", "1G", "--force", "--json")
        )
        assert done["num_gaussians"] == NUM_GAUSSIANS and (tmp_path / "a.splatree").read_bytes() == wanted
    monkeypatch.setattr("splatree.cli.build.needs_of", lambda *_: Needs(10**10, 10**10))
    code, said, _ = splatree("build", small_ply, tmp_path / "short.splatree", *words)
    assert code == 0 and "note: the build takes about 10.0 GB in memory" in said and "50 clusters" in said
    code, _, err = splatree("build", small_ply, tmp_path / "a.rad", *words, "--max-memory", "1G")
    assert code == 2 and "found --max-memory and a format that is not written in parts" in err


def test_build_by_pairs_makes_levels_that_are_drawn_by_their_extents(splatree, small_ply, tmp_path):
    target = tmp_path / "a.splatree"
    code, words, _ = splatree("build", small_ply, target, "--method", "pairs")
    assert code == 0
    assert "pixel" in words
    assert json.loads(read(target).source.metadata["levels"])["rule"] == "pairs"
    counts = []
    for profile in ((), ("--profile", "pixel")):
        folder = tmp_path / f"frames{len(counts)}"
        views = result_of(splatree("render", target, "-o", folder, "--views", "2", *SIZE, *profile, "--json"))["views"]
        counts.append([view["selected"] for view in views])
    assert counts[0] == counts[1]


def test_culling_draws_the_same_pictures(splatree, small_ply, tmp_path):
    result_of(splatree("build", small_ply, tmp_path / "a.splatree", "--clusters", "60", "--flat", "--json"))
    pictures = []
    for rule in ("none", "exact"):
        words = ("-o", tmp_path / rule, "--views", "2", *SIZE, "--cull", rule, "--json")
        views = result_of(splatree("render", tmp_path / "a.splatree", *words))["views"]
        pictures.append([Path(view["file"]).read_bytes() for view in views])
    assert pictures[0] == pictures[1]


def test_convert_writes_the_same_gaussians(splatree, small_tree, tmp_path):
    converted = result_of(splatree("convert", small_tree, tmp_path / "out.ply", "--json"))
    assert converted["num_gaussians"] == len(read(tmp_path / "out.ply")) == NUM_GAUSSIANS
    assert converted["bytes"] == (tmp_path / "out.ply").stat().st_size


def test_convert_writes_a_folder_of_sog(splatree, small_ply, tmp_path):
    converted = result_of(splatree("convert", small_ply, tmp_path / "folder" / "meta.json", "--json"))
    assert converted["num_gaussians"] == len(read(tmp_path / "folder")) == NUM_GAUSSIANS
    stored = sum(path.stat().st_size for path in (tmp_path / "folder").iterdir())
    assert converted["bytes"] == stored
    (tmp_path / "folder" / "notes.txt").write_text("not of the scene")
    for named in ("folder", "folder/meta.json"):
        assert result_of(splatree("info", tmp_path / named, "--json"))["file_bytes"] == stored


def test_a_tree_needs_a_format_with_levels(splatree, small_ply, tmp_path):
    code, _, err = splatree("build", small_ply, tmp_path / "tree.ply")
    assert code == 2 and "format ply has no levels of detail, wanted .splatree" in err


@pytest.mark.parametrize(
    ("options", "count"),
    [(("--keep", "0.25"), NUM_GAUSSIANS / 4), (("--count", "500"), 500), (("--radius", "20"), None)],
)
def test_thin_leaves_what_was_asked_for(splatree, small_ply, tmp_path, options, count):
    thinned = result_of(splatree("thin", small_ply, tmp_path / "out.ply", *options, "--json"))
    assert thinned["num_read"] == NUM_GAUSSIANS
    assert thinned["num_gaussians"] == len(read(tmp_path / "out.ply")) < NUM_GAUSSIANS
    if count is not None:
        assert thinned["num_gaussians"] == pytest.approx(count, rel=0.01)  # the promise of --keep and --count
    else:
        assert thinned["radius"] == 20


def test_build_takes_two_names_or_many_inputs(splatree, small_ply, tmp_path):
    one = result_of(splatree("build", small_ply, tmp_path / "one.splatree", "--json"))
    two = result_of(splatree("build", small_ply, small_ply, "-o", tmp_path / "two.splatree", "--json"))
    assert one["num_gaussians"] == NUM_GAUSSIANS
    assert two["num_gaussians"] == 2 * NUM_GAUSSIANS
    tree = read(tmp_path / "one.splatree").tree
    assert one["num_nodes"] == len(tree)
    assert one["levels"] == tree.num_levels
    # Each merged node has at least two children, and every node but the roots is a child.
    assert min(map(int, one["children"])) >= 2
    assert sum(int(c) * n for c, n in one["children"].items()) == one["num_nodes"] - one["num_roots"]


def test_render_makes_an_orbit_or_follows_cameras(splatree, small_tree, tmp_path):
    made = result_of(splatree("render", small_tree, "-o", tmp_path / "orbit", "--views", "2", *SIZE, "--json"))
    assert [Path(view["file"]).name for view in made["views"]] == ["view_0000.png", "view_0001.png"]
    assert read_image(tmp_path / "orbit" / "view_0000.png").shape == (36, 64, 3)
    cameras = [
        {"id": i, "img_name": f"photos/{name}.jpg", "width": 80, "height": 60, "fx": 60, "fy": 60}
        | {"position": [215, -120, 370], "rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]]}
        for i, name in enumerate("ab")
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    words = ("render", small_tree, "--cameras", tmp_path / "cameras.json", "-o", tmp_path / "given")
    given = result_of(splatree(*words, "--scale", "0.5", "--background", "1", "0", "0", "--json"))
    assert sorted(path.name for path in (tmp_path / "given").iterdir()) == ["a.png", "b.png"]
    image = read_image(tmp_path / "given" / "a.png")
    assert image.shape == (30, 40, 3)
    assert image.std() > 0.05  # something is drawn
    assert given["views"][0]["selected"] > 0


def test_thin_and_build_say_what_is_lost(splatree, small_ply, tmp_path):
    thinned = splatree("thin", small_ply, tmp_path / "a.splat", "--keep", "0.5")[1].splitlines()
    assert [line.split(":")[0] for line in thinned[1:]] == ["lost"] * 3  # harmonics, precision, clipped colours
    built = splatree("build", small_ply, tmp_path / "a.hier", "--clusters", "20")[1]
    assert "lost: the" in built and "clusters" in built.split("lost:")[1]


@pytest.mark.parametrize("verb", ["info", "convert", "thin", "build", "render", "eval"])
def test_every_verb_that_reads_a_scene_can_repair_it(splatree, small_scene, tmp_path, verb):
    path = tmp_path / "nan.ply"
    write(Scene.flat(small_scene.gaussians.take(np.arange(50))), path)
    data = bytearray(path.read_bytes())
    start = data.index(b"end_header\n") + 11
    data[start : start + 4] = np.float32(np.nan).tobytes()
    path.write_bytes(data)
    words = {
        "info": [],
        "render": ["-o", tmp_path / "frames", "--views", "1", *SIZE],
        "eval": ["--views", "1", "--frames", "0", *SIZE],
    }.get(verb, [tmp_path / "out.splatree"])
    code, _, err = splatree(verb, path, *words)
    assert code == 1 and "read it with repair" in err
    assert splatree(verb, path, *words, "--repair")[0] == 0


def test_every_verb_takes_the_axes_of_a_file_that_names_none(splatree, small_scene, tmp_path):
    spz, ply = tmp_path / "a.spz", tmp_path / "a.ply"
    write(Scene.flat(small_scene.gaussians.take(np.arange(50))), spz, options=WriteOptions(format_version=3))
    raw = bytearray(gzip.decompress(spz.read_bytes()))
    flags = 14
    raw[flags] &= ~2  # no extension records, so that nothing names the axes
    spz.write_bytes(gzip.compress(raw[:-12]))
    assert splatree("thin", spz, ply, "--keep", "1", "--input-axes", "LUF")[0] == 0
    np.testing.assert_allclose(read(ply).gaussians.means, read(spz, axes="LUF").gaussians.means)
    assert "LUF, as told" in splatree("info", spz, "--input-axes", "LUF")[1]


def test_render_says_once_what_to_know_of_the_selection(splatree, small_tree, tmp_path):
    words = ("render", small_tree, "-o", tmp_path, "--views", "2", *SIZE, "--profile", "exact", "--pixel-error", "0.5")
    code, out, _ = splatree(*words)
    assert code == 0
    assert out.count("note: pixel_error 0.5 px is below") == 1


def test_what_has_nothing_to_merge_is_built_without_a_table(splatree, small_scene, tmp_path):
    write(Scene.flat(small_scene.gaussians.take(np.arange(1))), tmp_path / "one.ply")
    code, out, _ = splatree("build", tmp_path / "one.ply", tmp_path / "one.splatree")
    assert code == 0
    assert out.startswith("wrote ")


def test_budget_bounds_the_nodes_of_each_view(splatree, small_tree, tmp_path):
    words = ("render", small_tree, "-o", tmp_path, "--views", "2", *SIZE, "--budget", "200", "--json")
    rendered = result_of(splatree(*words))
    assert all(view["selected"] <= 200 and view["pixel_error"] > 3 for view in rendered["views"])


def test_eval_compares_with_all_leaves(splatree, small_tree):
    words = ("eval", small_tree, "--views", "2", *SIZE, "--pixel-error", "20", "--frames", "3", "--json")
    evaluated = result_of(splatree(*words))
    assert "no photographs" in evaluated["compared_with"]
    assert evaluated["timing"]["num_frames"] == 3
    assert set(evaluated["timing"]["cpu_ms"]) == {"select", "project", "bin", "blend"}
    assert 0 < evaluated["num_bytes"]["tree"] < evaluated["num_bytes"]["gaussians"] < evaluated["num_bytes"]["peak"]
    assert evaluated["num_gaussians"] == NUM_GAUSSIANS
    for view in evaluated["views"]:
        assert view["selected"] < view["leaves_selected"]
        assert 5 < view["psnr_vs_leaves"] < 60
        assert set(view["ms"]) == {"select", "project", "bin", "blend"}
    assert evaluated["mean"]["psnr_vs_leaves"] == pytest.approx(
        np.mean([v["psnr_vs_leaves"] for v in evaluated["views"]])
    )


def test_means_are_said_without_powers_of_ten(splatree, small_tree):
    words = ("eval", small_tree, "--views", "1", "--frames", "0", "--width", "1280", "--height", "720")
    code, out, _ = splatree(*words)
    assert code == 0
    assert re.search(r"^mean: selected \d,\d{3}, pairs \d,\d{3}, pixel_error 3, ", out, flags=re.MULTILINE)


def test_eval_of_equal_pictures_is_null_in_json(splatree, small_ply):
    evaluated = result_of(splatree("eval", small_ply, "--views", "1", *SIZE, "--frames", "0", "--json"))
    assert evaluated["timing"] is None
    assert evaluated["views"][0]["psnr_vs_leaves"] is None
    assert evaluated["views"][0]["ssim_vs_leaves"] == pytest.approx(1)


def test_the_mean_of_a_psnr_is_that_of_the_pictures_that_differ(splatree, small_tree, tmp_path):
    near, far = cameras = list(orbit(read(small_tree), PathOptions(views=2, width=96, height=64)))
    away = near.camera_from_world.copy()
    away[:3] *= np.array([[-1], [1], [-1]])  # turned about: nothing is in view
    write_cameras(Cameras((replace(near, camera_from_world=away), far)), tmp_path / "cameras.json")
    words = ("--cameras", tmp_path / "cameras.json", "--pixel-error", "20", "--frames", "0", "--json")
    evaluated = result_of(splatree("eval", small_tree, *words))
    equal, other = (view["psnr_vs_leaves"] for view in evaluated["views"])
    assert equal is None and len(cameras) == 2
    assert evaluated["mean"]["psnr_vs_leaves"] == pytest.approx(other)


def test_eval_finds_the_photographs_and_the_cameras_beside_them(splatree, small_tree, tmp_path):
    cameras = flyout(read(small_tree), PathOptions(views=2, width=64, height=36))
    write_cameras(cameras, tmp_path / "cameras.json")
    words = ("--cameras", tmp_path / "cameras.json", "-o", tmp_path / "images", "--pixel-error", "0")
    assert splatree("render", small_tree, *words)[0] == 0
    (tmp_path / "images" / "view_0001.png").unlink()
    words = ("eval", small_tree, "--data", tmp_path, "--frames", "0", "--json")
    evaluated = result_of(splatree(*words, "--held-out", "1"))
    assert "all views, said to be held out: 2 of 2" in evaluated["compared_with"]
    first, second = evaluated["views"]
    # The photograph is the picture of all leaves, rounded to 8 bits: at most half a step off, so better than 20 log10(510) dB.
    assert first["leaves_psnr_vs_photo"] > 54
    assert first["psnr_vs_photo"] == pytest.approx(first["psnr_vs_leaves"], abs=0.1)
    assert second["psnr_vs_photo"] is None


@pytest.fixture(scope="module")
def photographed(small_tree, tmp_path_factory):
    """A folder of ten pictures of the scene, drawn from all leaves, with their cameras."""
    folder = tmp_path_factory.mktemp("photos")
    scene = read(small_tree)
    cameras = flyout(scene, PathOptions(views=10, width=64, height=36))
    write_cameras(cameras, folder / "cameras.json")
    (folder / "images").mkdir()
    for camera in cameras:
        image = render(scene, camera, select=SelectOptions(pixel_error=0)).image
        write_image(image, folder / "images" / f"{camera.name}.png")
    return folder


def test_eval_scores_held_out_views_and_keeps_training_views_apart(splatree, small_tree, photographed):
    words = ("eval", small_tree, "--data", photographed, "--pixel-error", "20", "--frames", "0", "--json")
    held_out = result_of(splatree(*words))
    assert [view["name"] for view in held_out["views"]] == ["view_0000", "view_0008"]
    assert "every 8th view from the first: 2 of 10" in held_out["compared_with"]
    assert held_out["training_mean"] == {}
    both = result_of(splatree(*words, "--training"))
    assert [view["held_out"] for view in both["views"]] == [True] * 2 + [False] * 8
    assert both["mean"]["psnr_vs_photo"] == held_out["mean"]["psnr_vs_photo"]
    training = [view["psnr_vs_photo"] for view in both["views"] if not view["held_out"]]
    assert both["training_mean"]["psnr_vs_photo"] == pytest.approx(np.mean(training))


def test_eval_takes_held_out_views_from_a_list(splatree, small_tree, photographed, tmp_path):
    (tmp_path / "test.txt").write_text("view_0003\nview_0004.png\n")
    words = ("eval", small_tree, "--data", photographed, "--frames", "0", "--json")
    evaluated = result_of(splatree(*words, "--held-out", tmp_path / "test.txt"))
    assert [view["name"] for view in evaluated["views"]] == ["view_0003", "view_0004"]


def test_eval_refuses_views_that_the_threshold_was_calibrated_on(splatree, small_tree, photographed, tmp_path):
    scene = read(small_tree)
    record = {"photographs": True, "views": ["view_0001", "view_0008"]}
    source = replace(scene.source, metadata={**scene.source.metadata, METADATA_KEY: json.dumps(record)})
    write(replace(scene, source=source), tmp_path / "calibrated.splatree")
    words = ("eval", tmp_path / "calibrated.splatree", "--data", photographed, "--frames", "0")
    code, out, err = splatree(*words)
    assert (code, out) == (1, "")
    assert "'view_0008' and 0 more" in err and "hold out others" in err
    (tmp_path / "test.txt").write_text("view_0000\n")
    assert splatree(*words, "--held-out", tmp_path / "test.txt")[0] == 0


def test_eval_with_a_published_method(splatree, small_tree):
    words = ("eval", small_tree, "--views", "2", *SIZE, "--frames", "0", "--json")
    views = {m: result_of(splatree(*words, "--method", m))["views"] for m in ("3dgs", "filtergs", "roots")}
    ours = result_of(splatree(*words))["views"]
    assert [v["selected"] for v in views["filtergs"]] == [v["selected"] for v in ours]
    assert all(v["ssim_vs_leaves"] == pytest.approx(1) for v in views["3dgs"])
    assert all(v["psnr_vs_leaves"] < 40 for v in views["roots"])


def test_eval_without_a_picture_named_like_a_camera_is_refused(splatree, small_tree, tmp_path):
    write_cameras(flyout(read(small_tree), PathOptions(views=1)), tmp_path / "cameras.json")
    code, out, err = splatree("eval", small_tree, "--data", tmp_path)
    assert (code, out) == (1, "")
    assert "view_0000" in err


def test_formats_lists_what_is_read_and_written(splatree):
    lines = {line["name"]: line for line in result_of(splatree("formats", "--json"))}
    assert lines["ply"]["written"] and lines["ply"]["suffixes"] == [".ply"]
    assert not lines["streamed-sog"]["written"]
    assert lines["splatree"]["levels"] == "tree"
    assert [name for name, line in lines.items() if line["record"]] == ["splatree", "splatree-folder", "rad"]


def test_names_of_pictures_are_safe_and_unique():
    def camera(name):
        return Camera(np.eye(4), np.eye(3), 2, 2, name=name)

    names = file_names([camera("a/left.jpg"), camera("../../etc/x y.png"), camera("b/left.jpg"), camera("")])
    assert names == ["0000", "x_y", "0002", "0003"]


def test_build_through_files_writes_a_folder_that_every_verb_takes(splatree, small_ply, tmp_path):
    folder = tmp_path / "a.splatree"
    built = result_of(splatree("build", small_ply, folder, "--max-memory", "1G", "--part-rows", "500", "--json"))
    whole = result_of(splatree("build", small_ply, tmp_path / "whole.splatree", "--no-follow", "--json"))
    assert (built["num_gaussians"], built["num_nodes"]) == (whole["num_gaussians"], whole["num_nodes"])
    assert built["rules"] == whole["rules"] and built["num_parts"] > 1
    described = result_of(splatree("info", folder, "--json"))
    assert described["format"] == "splatree-folder" and described["file_bytes"] > built["bytes"]
    against = ("--reference", tmp_path / "whole.splatree", "--views", "2", *SIZE)
    compared = result_of(splatree("eval", folder, *against, "--pixel-error", "0", "--json"))
    assert compared["all"]["psnr"] is None and compared["all"]["num_drawn"] > 0  # the leaves are equal
    assert splatree("convert", folder, tmp_path / "one.splatree", "-q")[0] == 0
    assert splatree("build", small_ply, folder, "--part-rows", "500")[0] == 1  # it exists
    code, words, _ = splatree("build", small_ply, folder, "--part-rows", "500", "--force")
    assert code == 0 and "parts" in words and "nodes left" in words


def test_a_build_that_does_not_fit_goes_through_files_by_itself(splatree, small_ply, tmp_path, monkeypatch):
    monkeypatch.setattr("splatree.outofcore.needs.free_bytes", lambda: 200_000_000)
    code, words, _ = splatree("build", small_ply, tmp_path / "a.splatree")
    assert code == 0 and (tmp_path / "a.splatree").is_dir()
    assert "note: the build takes about 0.1 GB in memory, more than half of the 0.2 GB that are free: a folder" in words
    for name, more, why in (("b.splatree", ("--compact",), "--compact"), ("b.rad", (), ".rad")):
        built = result_of(splatree("build", small_ply, tmp_path / name, *more, "--json"))
        assert (tmp_path / name).is_file()
        assert built["notes"][0].endswith(f"that are free, and it cannot go through files with {why}")
    monkeypatch.setattr("splatree.outofcore.needs.free_bytes", lambda: 2_000_000_000)
    assert result_of(splatree("build", small_ply, tmp_path / "c.splatree", "--json"))["notes"] == []
    assert (tmp_path / "c.splatree").is_file()


def test_thin_through_files_writes_the_same_file(splatree, small_ply, tmp_path):
    for amount in (("--radius", "20"), ("--keep", "0.3", "--method", "radius")):
        whole = result_of(splatree("thin", small_ply, tmp_path / "whole.ply", *amount, "--json", "--force"))
        parts = result_of(
            splatree("thin", small_ply, tmp_path / "parts.ply", *amount, "--part-rows", "500", "--json", "--force")
        )
        assert (tmp_path / "parts.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
        assert parts["radius"] == whole["radius"] and parts["num_gaussians"] == whole["num_gaussians"]
    code, words, _ = splatree("thin", small_ply, tmp_path / "more.ply", "--max-memory", "1G")
    assert code == 0 and ", radius " in words
    code, _, err = splatree("thin", small_ply, tmp_path / "out.ply", "--keep", "0.3", "--max-memory", "1G")
    assert code == 2 and "wanted --method radius" in err
    code, _, err = splatree("thin", small_ply, tmp_path / "out.ply", "--workers", "2", "--report", tmp_path / "r")
    assert code == 2 and "found --report with --max-memory" in err


def test_folders_are_drawn_and_scored_without_reading_all_of_them(splatree, small_ply, tmp_path, monkeypatch):
    folder, one = tmp_path / "a.splatree", tmp_path / "one.splatree"
    assert splatree("build", small_ply, folder, "--part-rows", "500", "-q")[0] == 0
    assert splatree("convert", folder, one, "-q")[0] == 0
    cameras = tmp_path / "cameras.json"
    write_cameras(flyout(read(one), PathOptions(views=2, width=48, height=32)), cameras)
    views = ("--cameras", cameras)
    drawn = result_of(splatree("render", one, "-o", tmp_path / "read", *views, "--json"))
    scored = result_of(splatree("eval", one, *views, "--frames", "2", "--json"))
    monkeypatch.setattr("splatree.cli.opening.read_scene", None)  # nothing is read as a whole
    for path, words in ((folder, ()), (folder, ("--max-memory", "1M")), (one, ("--max-memory", "1M"))):
        found = result_of(splatree("render", path, "-o", tmp_path / "paged", "--force", *words, *views, "--json"))
        assert [view["selected"] for view in found["views"]] == [view["selected"] for view in drawn["views"]]
        for view in drawn["views"]:
            name = Path(view["file"]).name
            assert (tmp_path / "paged" / name).read_bytes() == (tmp_path / "read" / name).read_bytes()
        found = result_of(splatree("eval", path, *words, *views, "--frames", "2", "--json"))
        assert found["mean"] == scored["mean"]
        for name in ("num_gaussians", "num_nodes", "levels"):
            assert found[name] == scored[name]
    assert splatree("render", folder, "-o", tmp_path / "made.png", "-q")[0] == 0  # a view is chosen for it
    monkeypatch.setattr(
        "splatree.cli.opening.free_bytes", lambda: 2 * one.stat().st_size - 1
    )  # one file is large, then
    assert splatree("render", one, "-o", tmp_path / "paged", "--force", *views, "-q")[0] == 0
    for view in drawn["views"]:
        name = Path(view["file"]).name
        assert (tmp_path / "paged" / name).read_bytes() == (tmp_path / "read" / name).read_bytes()
    monkeypatch.undo()
    monkeypatch.setattr("splatree.cli.opening.open_store", None)  # half of what is free will do
    monkeypatch.setattr("splatree.cli.opening.free_bytes", lambda: 2 * one.stat().st_size)
    assert splatree("render", one, "-o", tmp_path / "small.png", "-q")[0] == 0
    monkeypatch.undo()
    for path, words in ((small_ply, ()), ("-", ()), (folder, ("--level", "0")), (folder, ("--rule", "release"))):
        code, _, err = splatree("render", path, "-o", tmp_path / "no.png", "--max-memory", "1M", *words)
        assert code == 2 and "max_memory: found" in err
    assert "--rule, which needs all rows in memory" in err
    assert splatree("render", folder, "-o", tmp_path / "release.png", "--rule", "release", "-q")[0] == 0
    monkeypatch.setattr("splatree.cli.opening.free_bytes", lambda: 1000)
    code, _, err = splatree("render", folder, "-o", tmp_path / "no.png", "--rule", "release")
    assert code == 2 and f"--rule: needs all rows of {folder} in memory, " in err and "0.0 GB are free" in err


def test_build_through_files_refuses_what_needs_the_scene_in_memory(splatree, small_ply, tmp_path):
    target = tmp_path / "a.splatree"
    for words, wanted in (
        (("--clusters", "auto"), "added afterwards: splatree build FOLDER out.splatree --flat --clusters auto"),
        (("--flat",), "need the scene in memory"),
        (("--flat", "--clusters", "auto"), "wanted --max-memory alone"),
        (("--max-memory", "4 gallons"), "wanted a number of bytes such as 4G"),
    ):
        code, _, err = splatree("build", small_ply, target, "--workers", "2", *words)
        assert code == 2 and wanted in err
    code, _, err = splatree("build", small_ply, target, "--workers", "2", "--scheduler", "tcp://here:1")
    assert code == 2 and "found 2 processes of this machine and a scheduler" in err
    code, _, err = splatree("build", small_ply, tmp_path / "a.ply", "--workers", "2")
    assert code == 2 and "ends in .splatree" in err
    assert list(tmp_path.glob("a.*")) == []
