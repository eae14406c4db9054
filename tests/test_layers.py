"""Imports point down only: the contract in pyproject.toml, checked on the package that is imported here."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def test_imports_point_down_only(monkeypatch, capsys):
    cli = pytest.importorskip("importlinter.cli", reason="import-linter (extra test) is not installed")
    monkeypatch.chdir(ROOT)
    kept = cli.lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0
    assert kept, capsys.readouterr().out
