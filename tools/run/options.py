"""The configuration of a teaching session, and what is built from it.

One tree of frozen dataclasses is the schema of the TOML file, of ``--set`` and of the configuration that each
log carries. Defaults are the paper's where the paper gives a value.
"""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions, ModeOptions
from hm_driver.realtime.options import TimingOptions, WatchOptions
from teaching.accumulator import Accumulator
from teaching.arbitration import ExistenceArbitration, check_thresholds
from teaching.hands.simulated import DemonstratorOptions
from teaching.lwr import LWR
from teaching.session import Session, SessionOptions
from teaching.task import Task

TICK_S = 0.01
"""Learning and arbitration run at 100 Hz, as in the paper."""


class PruneRule(Enum):
    """Which reading of the paper's pruning rule is taken."""

    OVERLAP = "overlap"
    """Two models that a point activates above w_prune and that activate each other's centre as much."""
    PAPER = "paper"
    """Two models that a point activates above w_prune, to the letter."""
    NEVER = "never"
    """None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnerOptions:
    """The learner of eqs. (1) to (7)."""

    D: float = 400.0
    """Diagonal of the distance metric [1/m^2]."""
    w_gen: float = 0.8
    """Activation below which a sample makes a new model."""
    w_prune: float = 0.9
    """Activation above which two models are one too many."""
    prune: PruneRule = PruneRule.OVERLAP
    """Reading of the pruning rule."""
    lam: float = 1.0
    """Forgetting factor of eq. (7); 1 forgets nothing."""
    P0: float = 1e6
    """Initial covariance of a local model."""

    def build(self) -> LWR:
        """The learner.

        Raises:
            ConfigurationError: A value is out of range.
        """
        return LWR(
            D=self.D,
            w_gen=self.w_gen,
            w_prune=self.w_prune,
            lam=self.lam,
            P0=self.P0,
            prune=self.prune.value,
        )

    def __post_init__(self) -> None:
        self.build()


@dataclass(frozen=True, slots=True, kw_only=True)
class ArbitrationOptions:
    """The arbitration of eq. (9)."""

    w_th: float = 0.5
    """Activation at which control changes hands."""
    d: float = 0.05
    """Width of the blend in activation."""

    def build(self) -> ExistenceArbitration:
        """The arbitration.

        Raises:
            ConfigurationError: A value is out of range.
        """
        return ExistenceArbitration(self.w_th, self.d)

    def __post_init__(self) -> None:
        self.build()


@dataclass(frozen=True, slots=True, kw_only=True)
class AccumulationOptions:
    """The accumulation of eqs. (10) and (11)."""

    N_acc: int = 1000
    """Samples of an update."""
    downsample: int = 1
    """Keep every how manieth sample."""

    def __post_init__(self) -> None:
        if not 1 <= self.N_acc <= 1_000_000:
            raise ConfigurationError("N_acc", f"{self.N_acc} must be 1 to 1000000")
        if not 1 <= self.downsample <= self.N_acc:
            raise ConfigurationError("downsample", f"{self.downsample} must be 1 to N_acc = {self.N_acc}")


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachOptions:
    """Everything about a teaching session."""

    task: str = "paper"
    """Name of a task that is shipped, or path of a TOML file."""
    learner: LearnerOptions = field(default_factory=LearnerOptions)
    arbitration: ArbitrationOptions = field(default_factory=ArbitrationOptions)
    accumulation: AccumulationOptions = field(default_factory=AccumulationOptions)
    session: SessionOptions = field(default_factory=SessionOptions)
    demonstrator: DemonstratorOptions = field(default_factory=DemonstratorOptions)
    geometry: ArmGeometry = field(default_factory=ArmGeometry)
    modes: ModeOptions = field(default_factory=ModeOptions)
    limits: LimitOptions = field(default_factory=LimitOptions)
    timing: TimingOptions = field(default_factory=TimingOptions)
    watch: WatchOptions = field(default_factory=WatchOptions)
    init_timeout_s: float = 30.0
    """How long the device may take to initialise [s]."""

    def warnings(self) -> list[str]:
        """What contradicts itself without being wrong, with the consequence."""
        return self.learner.build().check_parameters() + check_thresholds(
            w_th=self.arbitration.w_th, d=self.arbitration.d, w_gen=self.learner.w_gen
        )


def build_session(options: TeachOptions, task: Task, rng: np.random.Generator) -> Session:
    """The session that the options describe.

    Args:
        options: The configuration.
        task: The loaded task.
        rng: Randomness of the accumulation's shuffling, eq. (11).
    """
    return Session(
        task=task,
        learner=options.learner.build(),
        arbitration=options.arbitration.build(),
        accumulator=Accumulator(options.accumulation.N_acc, options.accumulation.downsample, rng=rng),
        w_th=options.arbitration.w_th,
        assist_stiffness=options.modes.assist_stiffness,
        options=options.session,
    )
