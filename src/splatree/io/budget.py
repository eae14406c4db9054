"""How many rows an input may become: a few bytes must not ask for gigabytes of memory.

A file may name one part many times, and compressed parts may be far smaller than their rows. So rows are added up as they are
decoded and held against the bytes that they come from, each file counted once.
"""

from dataclasses import dataclass, field
from pathlib import Path

from splatree.errors import FormatError

__all__ = ["ROWS_ALWAYS", "RowBudget"]

ROWS_ALWAYS = 1 << 20
"""So many rows, at most 250 MB, are allowed of whatever bytes."""

ROWS_PER_BYTE = 16.0
"""Real compressed files hold one row in ten bytes and more; files of equal rows, as tests write them, compress further."""


@dataclass
class RowBudget:
    """Rows asked for so far, and the bytes that they come from."""

    where: str
    """The input, as errors name it."""
    rows_per_byte: float = ROWS_PER_BYTE
    """Rows that a byte may stand for."""
    num_rows: int = 0
    """Rows so far."""
    num_bytes: int = 0
    """Bytes so far, of distinct files."""
    _seen: set[Path] = field(default_factory=set)

    def add_file(self, path: Path) -> None:
        """Count the bytes of a file that was not counted yet, under whatever name."""
        real = path.resolve()
        if real not in self._seen and real.is_file():
            self._seen.add(real)
            self.num_bytes += real.stat().st_size

    def take(self, rows: int) -> None:
        """Ask for more rows.

        Raises:
            FormatError: they are more than the bytes can stand for.
        """
        self.num_rows += rows
        limit = max(ROWS_ALWAYS, int(self.rows_per_byte * self.num_bytes))
        if self.num_rows > limit:
            raise FormatError(
                f"{self.where}: found {self.num_rows:,} Gaussians or more from {self.num_bytes:,} bytes, wanted at most "
                f"{limit:,}: parts are named again and again, or the files are decompression bombs"
            )
