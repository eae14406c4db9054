"""The words of a command line: options between paths, forms that people try, hints, help with examples."""

import json
import re
import shlex
from importlib import import_module
from typing import get_args, get_origin

import numpy as np
import pytest

from splatree import read
from splatree.cli.examples import BASIC
from splatree.cli.help import examples_of
from splatree.cli.main import GROUPS, VERBS, _parsed, commands_of
from splatree.cli.words import options_of, sorted_words

COMMANDS = [*(v for v in VERBS if v not in GROUPS), *(f"{g} {c}" for g in GROUPS for c in commands_of(g))]


def command_of(name):
    verb, *rest = name.split()
    module = import_module(f"splatree.cli.{verb}")
    return module.COMMANDS[rest[0]] if rest else module.Command


def sort(verb, line):
    return sorted_words(shlex.split(line), options_of(command_of(verb)))


def test_options_may_stand_between_paths(splatree, small_ply, tmp_path):
    code, out, err = splatree("thin", small_ply, "--keep", "0.5", tmp_path / "a.ply", "--json")
    assert code == 0, err
    assert json.loads(out)["output"].endswith("a.ply")
    assert sort("convert", "a.ply --scale 2 b.ply --force") == ["a.ply", "b.ply", "--scale", "2", "--force"]
    assert sort("convert", "--scale 2 -o b.ply -- -odd-name.ply") == ["-odd-name.ply", "--scale", "2", "-o", "b.ply"]


def test_shares_may_be_written_in_percent(splatree, small_ply, tmp_path):
    code, out, _ = splatree("thin", small_ply, tmp_path / "a.ply", "--keep", "25%", "--json")
    assert code == 0
    assert json.loads(out)["num_gaussians"] == pytest.approx(3161 / 4, rel=0.02)
    assert sort("convert", "a b --min-opacity 2.5%") == ["a", "b", "--min-opacity", "0.025"]
    assert sort("thin", "50%.ply b.ply") == ["50%.ply", "b.ply"]


def test_numbers_below_zero_and_commas_are_values(splatree, small_ply, tmp_path):
    forms = (("--rotate", "-90,0,0"), ("--rotate=-90,0,0",), ("--rotate", "-90", "0", "0"))
    for i, words in enumerate(forms):
        code, _, err = splatree("convert", small_ply, *words, tmp_path / f"{i}.ply")
        assert code == 0, err
    turned = [read(tmp_path / f"{i}.ply").gaussians.means for i in range(3)]
    assert np.array_equal(turned[0], turned[1]) and np.array_equal(turned[0], turned[2])
    before = read(small_ply).gaussians.means
    assert np.allclose(turned[0][:, 1], before[:, 2], atol=1e-3)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("convert a b --overwrite", "found --overwrite, wanted --force"),
        ("render a --depth d.exr", "--depth: found 'd.exr', wanted png or exr"),
        ("build a b --clusters many", "--clusters: found 'many', wanted a whole number or auto"),
        ("render a --width 1.5", "--width: found '1.5', wanted a whole number"),
        ("convert a b --crop-box 0 0 0 1 1 q", "--crop-box: found 'q', wanted a number"),
        ("convert a b -y", "found -y, wanted --force"),
        ("convert a b -w", "found -w, wanted --force"),
        ("thin a b --ratio 0.5", "found --ratio, wanted --keep"),
        ("thin a b --kep 0.5", "did you mean --keep?"),
        ("thin a b --zebra", "which is no option of this verb"),
        ("convert a b --rotate 1 2", "wanted 3 numbers, such as --rotate 0 1 2"),
        ("convert a b --output", "--output: found nothing after it, wanted a value"),
        ("train a -o ''", "-o: found '', wanted a path; is a variable of the shell unset?"),
        ("serve a --packages ''", "--packages: found '', wanted a word; is a variable of the shell unset?"),
        ("render a --width ' '", "--width: found ' ', wanted a whole number; is a variable of the shell unset?"),
        ("convert a b --scale --force", "--scale: found '--force' after it, wanted a value"),
        ("rendr a", "did you mean render?"),
        ("bench tabel1", "did you mean table1?"),
        ("bench table1 a.ply", "found 'a.ply', wanted options only"),
        ("demo a.ply", "found 'a.ply', wanted options only"),
        ("train", "found no path, wanted the photos"),
        ("serve a b", "found 'b', wanted folder and nothing else"),
        ("rtl", "found no --output"),
        ("build a.ply", "in.ply out.splatree"),
        ("convert a.ply", "in.ply out.ply"),
        ("tests", "wanted a verb before it: splatree info tests"),
    ],
)
def test_wrong_words_are_one_line_with_a_hint(splatree, line, said):
    code, out, err = splatree(*shlex.split(line))
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert said in err


@pytest.mark.parametrize("words", [("bench",), ("bench", "help"), ("bench", "-h"), ("help", "bench")])
def test_help_of_a_group_lists_its_commands(splatree, words):
    code, out, err = splatree(*words)
    assert (code, err) == (0, "")
    assert all(f"  {name} " in out for name in commands_of("bench"))


@pytest.mark.parametrize("words", [(), ("help",), ("--help",), ("-h",)])
def test_help_needs_no_dashes(splatree, words):
    code, out, err = splatree(*words)
    assert (code, err) == (0, "")
    assert all(verb in out for verb in VERBS)


def test_help_of_a_verb_may_be_asked_for_both_ways(splatree):
    assert splatree("help", "thin") == splatree("thin", "--help")
    assert splatree("thin", "a.ply", "--keep", "0.5", "-h") == splatree("thin", "--help")
    assert splatree("help", "bench", "fig5") == splatree("bench", "fig5", "--help")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_two_examples_groups_and_no_jargon_of_the_parser(splatree, name):
    code, out, _ = splatree(*name.split(), "--help")
    assert code == 0
    assert len(re.findall(rf"^  splatree {name}\b", out, flags=re.MULTILINE)) == 2
    assert "basic options:" in out
    assert not re.search(r"\(default: None\)|\{None\}|\bNone: |\(default: False\)", out)
    assert max(map(len, out.splitlines())) <= 110
    for option in options_of(command_of(name)):
        assert option.name.upper() in out if option.is_positional else option.name in out


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_are_command_lines(name):
    for example in examples_of(name, command_of(name)):
        words = shlex.split(example)[1 + len(name.split()) :]
        sorted_words(words, options_of(command_of(name)))


def some_words(option):
    """An option with values of its kind, which need not make sense."""
    kinds = get_args(option.kind) if get_origin(option.kind) is tuple else (option.kind,)
    if option.kind is bool:
        return [option.name]
    return [option.name, *(some_value(kind) for kind in kinds if kind is not Ellipsis)]


def some_value(kind):
    kind = next(iter(get_args(kind)), kind)
    return str(kind) if isinstance(kind, str) else "1"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_of_the_help_is_taken(capsys, name):
    """Those of structs within structs, too: their values may be refused, their names may not."""
    options = options_of(command_of(name))
    words = ["a.ply"] * any(option.is_positional for option in options)
    words += [word for option in options if not option.is_positional for word in some_words(option)]
    _parsed(name, words, command_of(name), None)
    said = capsys.readouterr().err
    assert "options" not in said and "╭" not in said, said


def test_options_of_merging_have_no_prefix():
    for verb in ("thin", "build"):
        words = ["in.ply", "out.splatree", "--mass-limit", "3", "--scale-bound", "2"]
        merge = _parsed(verb, words, command_of(verb), None).options.merge
        assert (merge.mass_limit, merge.scale_bound) == (3, 2)


def test_refused_values_within_structs_are_one_line(splatree):
    code, _, err = splatree("thin", "in.ply", "out.ply", "--mass-limit", "0")
    assert (code, err) == (2, "splatree thin: error: mass_limit: found 0.0, wanted 1 or more\n")


def test_basic_options_exist():
    for name, chosen in BASIC.items():
        known = {option.name.removeprefix("--").removeprefix("no-") for option in options_of(command_of(name))}
        assert set(chosen) <= known, name


def test_the_help_shows_what_the_docstrings_say(splatree):
    out = " ".join(splatree("thin", "--help")[1].split())
    assert "--keep X Share of the Gaussians to keep" in out
    assert "--no-visibility Turn off: " in out and "(default: 0.5)" in out


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("eval {0} --held-out 4", "held_out: found 4 without --data"),
        ("eval {0} --lpips-trunk weights.pth", "lpips_trunk, lpips_heads: found weights without --lpips"),
        ("calibrate {0} out.splatree --held-out 4", "held_out: found 4 without --cameras or --data"),
        ("calibrate {0} out.splatree --scale 0.5", "scale: found 0.5 without --cameras or --data"),
        ("bench table3 --scene {0} --held-out 4", "held_out: found 4 without --data"),
        (
            "bench table1 --scene {0} --lpips-heads weights.pth",
            "lpips_trunk, lpips_heads: found weights without --lpips",
        ),
    ],
)
def test_options_that_would_do_nothing_are_refused(splatree, small_tree, line, said):
    code, out, err = splatree(*line.format(small_tree).split())
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert said in err


@pytest.mark.parametrize(
    ("line", "taken"),
    [
        ("bench cullfuzz -o {0}", "cullfuzz.json"),
        ("bench table3 -o {0}", "table3.json"),
        ("simulate --trace-from table1 -o {0}", "machine.toml"),
        ("simulate --trace-from table1 --traces {0}", "frame_000.npz"),
    ],
)
def test_outputs_are_checked_before_the_work(splatree, monkeypatch, tmp_path, line, taken):
    """What is measured for minutes shall not be lost at the end."""
    monkeypatch.setattr("splatree.cli.bench.check_drawable", lambda: None)
    for module in ("splatree.bench.cullfuzz", "splatree.bench.table3"):
        monkeypatch.setattr(f"{module}.run", lambda options: pytest.fail("work was begun"))
    monkeypatch.setattr("splatree.cli.simulate.on_machine", lambda *more: pytest.fail("work was begun"))
    (tmp_path / taken).write_text("old")
    for folder, said in ((tmp_path, f"{taken}: exists already"), (tmp_path / taken, "cannot be made a folder")):
        code, out, err = splatree(*line.format(folder).split())
        assert (code, out) == (1, "") and said in err, err
    assert (tmp_path / taken).read_text() == "old"
