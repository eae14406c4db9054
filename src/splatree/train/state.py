"""What a run is at one step: everything that the next step depends on, and what was learned about the run."""

from dataclasses import dataclass, field

from splatree.train.densify import Rows, Sightings
from splatree.train.exposure import Exposures
from splatree.train.schedule import LogEntry
from splatree.train.score import Score

__all__ = ["Scored", "State"]


@dataclass(frozen=True)
class Scored:
    """The scene at a share of the run.

    Example:
        >>> trained = st.train("photographs", st.TrainOptions(iterations=1, max_gaussians=100))
        >>> trained.history[-1].iterations
        1
    """

    share: float
    """Share of the run that was done."""
    iterations: int
    """Steps that were made."""
    cpu_s: float
    """Processor seconds that they took, without scores and files."""
    num_gaussians: int
    """Gaussians of the scene."""
    loss: float
    """Running mean of the loss."""
    score: Score | None
    """On the held-out photographs; None if there are none, or scores were not asked for."""


@dataclass
class State:
    """A run between two steps; fields are replaced as it goes on."""

    rows: Rows
    """The scene and the optimiser's moments."""
    seen: Sightings
    """What rows were seen to do since the last densification."""
    exposures: Exposures
    """Exposure of the photographs."""
    num_start: int
    """Gaussians at the beginning."""
    step: int = 0
    """Steps made."""
    loss: float = 0.0
    """Running mean of the loss."""
    spent_s: float = 0.0
    """Processor seconds of all steps."""
    round_s: float = 0.0
    """Processor seconds of the last round, as far as it has come."""
    log: list[LogEntry] = field(default_factory=list)
    """Rounds so far; the last may be under way."""
    history: list[Scored] = field(default_factory=list)
    """Scores so far."""

    @property
    def share(self) -> float:
        """p: the share of the run that is done."""
        last = self.log[-1] if self.log else None
        return 0.0 if last is None else last.share + (self.step - last.step) * last.growth

    @property
    def replay_log(self) -> list[LogEntry]:
        """The log, with a last round that ends at the present step."""
        return [LogEntry(e.step, e.share, e.growth, min(e.num_steps, self.step - e.step)) for e in self.log]
