"""How fast a page takes in what it is sent, and how much one message may hold.

A message cannot be taken back: while a long one is on its way over a slow line, newer views wait. The time from a message to its
acknowledgement says how many bytes a second a page takes in, line and browser together. Until a first message has said so, only
one is on its way. Afterwards a second one leaves when the first is expected to be taken in within half a second: so a line is
not idle, and a newer view waits for little more than the message that it finds on its way. Messages are kept to what the page
takes in within two seconds: a cut comes in more steps then, each of them exact.
"""

from collections import deque
from typing import Final

__all__ = ["Pace"]

STEP_S: Final = 2.0
"""Time that a page may take for one message. Of 10 Mbit a second: 2.5 MB, 70,000 nodes."""

TOLD_BYTES: Final = 65_536
"""Messages from this length on say how fast the line is; shorter ones say how long its way is."""

UNDER_WAY: Final = 2
"""Messages on their way at once."""

LEAD_S: Final = 0.5
"""A message leaves so long before the one on its way is taken in: the time to choose it, and the way to the page and back."""

FRESH: Final = 0.5
"""Weight of the newest message against those before."""


class Pace:
    """The pace of one page. Times are in seconds of any clock."""

    def __init__(self) -> None:
        self._under_way: deque[tuple[int, float]] = deque()
        self._num_acknowledged = 0
        self._last = 0.0
        self._rate: float | None = None

    def send(self, num_bytes: int, now: float) -> None:
        """A message leaves."""
        self._under_way.append((num_bytes, now))

    def acknowledge(self, count: int, now: float) -> None:
        """The page has taken in ``count`` messages since it connected; more than were sent are not counted."""
        while self._under_way and self._num_acknowledged < count:
            num_bytes, start = self._under_way.popleft()
            self._num_acknowledged += 1
            took = now - max(start, self._last)  # a message waits for the one before it
            if num_bytes >= TOLD_BYTES and took > 0:
                rate = num_bytes / took
                self._rate = rate if self._rate is None else (1 - FRESH) * self._rate + FRESH * rate
            self._last = now

    def wait_s(self, now: float) -> float:
        """Time until another message may leave, if nothing is acknowledged before; 0: at once."""
        if not self._under_way:
            return 0.0
        if self._rate is None or len(self._under_way) >= UNDER_WAY:
            return float("inf")
        num_bytes, start = self._under_way[0]
        taken_in = max(start, self._last) + num_bytes / self._rate
        return max(0.0, taken_in - LEAD_S - now)

    @property
    def step_bytes(self) -> float:
        """Bytes that one message may hold; infinite as long as nothing is known."""
        return float("inf") if self._rate is None else STEP_S * self._rate
