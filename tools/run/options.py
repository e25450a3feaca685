"""The configuration of a teaching session, and what is built from it.

One tree of frozen dataclasses is the schema of the TOML file, of ``--set`` and of the configuration that each
log carries. Defaults are the paper's where the paper gives a value.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions, ModeOptions
from hm_driver.realtime.options import TimingOptions, WatchOptions
from teaching.accumulator import Accumulator
from teaching.arbitration import (
    Arbitration,
    ButtonArbitration,
    ConfidenceArbitration,
    ErrorArbitration,
    ExistenceArbitration,
    SuccessArbitration,
    check_thresholds,
    force_success,
)
from teaching.correction import CorrectionOptions
from teaching.hands.simulated import DemonstratorOptions
from teaching.local_models import LocalModels, require_between
from teaching.lwr import LWR
from teaching.session import TICK_S, Coupling, Session, SessionOptions
from teaching.task import Task
from tools.config import Merged, Presets, merge
from tools.run.methods import PRESETS, Method

__all__ = [
    "TICK_S",
    "AccumulationOptions",
    "AdaptationOptions",
    "ArbitrationKind",
    "ArbitrationOptions",
    "ErrorOptions",
    "LearnerKind",
    "LearnerOptions",
    "MultiOptions",
    "PruneRule",
    "SuccessOptions",
    "TeachOptions",
    "build_session",
    "load_options",
]


class LearnerKind(Enum):
    """Which learner."""

    LWR = "lwr"
    """Locally weighted regression with fields of one size: the paper's."""
    MULTI = "multi"
    """The same, with finer fields where the prediction misses: ours."""
    RFWR = "rfwr"
    """Receptive field weighted regression: the fields adapt size and shape."""
    LWPR = "lwpr"
    """Locally weighted projection regression: adapting fields, regression along a few directions."""


class ArbitrationKind(Enum):
    """Who decides who is in control."""

    PAPER = "paper"
    """The existence of models: eq. (9)."""
    CONFIDENCE = "confidence"
    """Their existence and their confidence: ours."""
    ERROR = "error"
    """The average error of prediction, gradually: ours, in the spirit of the paper's [7]."""
    SUCCESS = "success"
    """The local success at holding the force, gradually: ours, in the spirit of the paper's [24]."""
    BUTTON = "button"
    """The human, with a button: in the spirit of HG-DAgger."""


class PruneRule(Enum):
    """Which reading of the paper's pruning rule is taken."""

    OVERLAP = "overlap"
    """Two models that a point activates above w_prune and that activate each other's centre as much."""
    PAPER = "paper"
    """Two models that a point activates above w_prune, to the letter."""
    NEVER = "never"
    """None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiOptions:
    """Fields of several sizes, for kind ``multi``."""

    levels: int = 3
    """Number of field sizes."""
    ratio: float = 16.0
    """D of a level by that of the next coarser one."""
    tolerance: float = 0.1
    """Share of the output that a prediction may miss before a finer model is made."""
    rehearse: int = 0
    """Remembered samples that are learned again for each new one; 0 remembers none."""

    def __post_init__(self) -> None:
        if not 0 <= self.rehearse <= 100:
            raise ConfigurationError("rehearse", f"{self.rehearse} must be 0 to 100")
        LWR(levels=self.levels, ratio=self.ratio, tolerance=self.tolerance, capacity=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class AdaptationOptions:
    """Fields that adapt, for kinds ``rfwr`` and ``lwpr``."""

    lam_final: float = 1.0
    """Forgetting factor that a field tends to."""
    tau: float = 0.9999
    """How slowly it does."""
    penalty: float = 1e-9
    """Weight of the penalty on small fields."""
    rate: float = 1000.0
    """Learning rate of the gradient descent at the beginning."""
    meta_rate: float = 250.0
    """Learning rate of the learning rates; 0 leaves them alone."""
    diagonal: bool = False
    """Whether D stays diagonal."""
    input_scale: float = 0.1
    """What counts as an input of size 1 for the rates and the penalty [m]."""
    output_scale: float = 0.05
    """What counts as an output of size 1 for the rates and the penalty [m]."""

    def __post_init__(self) -> None:
        require_between("lam_final", self.lam_final, 0.0, 1.0, closed=True)
        require_between("tau", self.tau, 0.0, 1.0, closed=True)
        require_between("penalty", self.penalty, -1e-300, 1e6)
        require_between("rate", self.rate, 0.0, 1e6)
        require_between("meta_rate", self.meta_rate, -1e-300, 1e6)
        require_between("input_scale", self.input_scale, 0.0, 1e3)
        require_between("output_scale", self.output_scale, 0.0, 1e3)


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnerOptions:
    """The learner of eqs. (1) to (7)."""

    kind: LearnerKind = LearnerKind.LWR
    """Which learner: lwr, multi, rfwr or lwpr."""
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
    multi: MultiOptions = field(default_factory=MultiOptions)
    adaptation: AdaptationOptions = field(default_factory=AdaptationOptions)

    def build(self) -> LocalModels:
        """The learner.

        Raises:
            ConfigurationError: A value is out of range.
        """
        if self.kind in (LearnerKind.RFWR, LearnerKind.LWPR):
            from teaching.lwpr import LWPR  # their kernels load only where they are used
            from teaching.rfwr import RFWR

            adapting = self.adaptation
            make = RFWR if self.kind is LearnerKind.RFWR else LWPR
            return make(
                D=self.D,
                w_gen=self.w_gen,
                w_prune=self.w_prune,
                lam=self.lam,
                P0=self.P0,
                prune=self.prune.value,
                lam_final=adapting.lam_final,
                tau=adapting.tau,
                penalty=adapting.penalty,
                rate=adapting.rate,
                meta_rate=adapting.meta_rate,
                diagonal=adapting.diagonal,
                input_scale=adapting.input_scale,
                output_scale=adapting.output_scale,
            )
        multi = self.multi
        if self.kind is LearnerKind.MULTI and multi.rehearse:
            from teaching.rehearsal import RehearsingLWR

            return RehearsingLWR(
                rehearse=multi.rehearse,
                D=self.D,
                w_gen=self.w_gen,
                w_prune=self.w_prune,
                lam=self.lam,
                P0=self.P0,
                prune=self.prune.value,
                levels=multi.levels,
                ratio=multi.ratio,
                tolerance=multi.tolerance,
            )
        return LWR(
            D=self.D,
            w_gen=self.w_gen,
            w_prune=self.w_prune,
            lam=self.lam,
            P0=self.P0,
            prune=self.prune.value,
            levels=multi.levels if self.kind is LearnerKind.MULTI else 1,
            ratio=multi.ratio,
            tolerance=multi.tolerance,
        )

    def __post_init__(self) -> None:
        self.build()


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorOptions:
    """The average error of prediction, for kind ``error``."""

    alone: float = 0.5
    """Relative error from which on the human is alone in control."""
    done: float = 0.1
    """Relative error up to which the skill is."""
    memory: float = 10.0
    """Time constant of the average [s]."""

    def build(self, w_th: float) -> ErrorArbitration:
        """The arbitration."""
        return ErrorArbitration(self.alone, self.done, self.memory, w_th=w_th)

    def __post_init__(self) -> None:
        self.build(0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class SuccessOptions:
    """The local success at holding the force, for kind ``success``."""

    tolerance: float = 1.0
    """Deviation from the reference force that is a full success [N]."""
    low: float = 0.5
    """Success up to which the human is alone in control."""
    high: float = 0.9
    """Success from which on the skill is."""
    memory: float = 0.3
    """Time constant of a cell's average [s]."""
    cell: float = 0.04
    """Edge of a cell [m]."""

    def build(self, reference_force: float, w_th: float, d: float) -> SuccessArbitration:
        """The arbitration."""
        return SuccessArbitration(
            force_success(reference_force, self.tolerance),
            low=self.low,
            high=self.high,
            memory=self.memory,
            cell=self.cell,
            w_th=w_th,
            d=d,
        )

    def __post_init__(self) -> None:
        if not self.tolerance > 0.0:
            raise ConfigurationError("tolerance", f"{self.tolerance} N must be above 0 N")
        self.build(1.0, 0.5, 0.05)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArbitrationOptions:
    """Who is in control."""

    kind: ArbitrationKind = ArbitrationKind.PAPER
    """Who decides: paper, confidence, error, success or button."""
    w_th: float = 0.5
    """Activation at which control changes hands, eq. (9)."""
    d: float = 0.05
    """Width of the blend in activation, eq. (9)."""
    doubt: float = 0.2
    """Standard deviation by the prediction from which on the human is in control, for kind confidence."""
    doubt_width: float = 0.1
    """Width of the blend in that."""
    error: ErrorOptions = field(default_factory=ErrorOptions)
    success: SuccessOptions = field(default_factory=SuccessOptions)

    def build(self, reference_force: float) -> Arbitration:
        """The arbitration.

        Args:
            reference_force: What the task asks for [N]; only the success is judged by it.

        Raises:
            ConfigurationError: A value is out of range.
        """
        if self.kind is ArbitrationKind.PAPER:
            return ExistenceArbitration(self.w_th, self.d)
        if self.kind is ArbitrationKind.CONFIDENCE:
            return ConfidenceArbitration(self.w_th, self.d, self.doubt, self.doubt_width)
        if self.kind is ArbitrationKind.ERROR:
            return self.error.build(self.w_th)
        if self.kind is ArbitrationKind.SUCCESS:
            return self.success.build(reference_force, self.w_th, self.d)
        return ButtonArbitration(w_th=self.w_th)

    def __post_init__(self) -> None:
        ConfidenceArbitration(self.w_th, self.d, self.doubt, self.doubt_width)


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

    method: Method = Method.PAPER
    """Which defaults: paper, confident, error, success or button. `load_options` reads them; made by hand, a
    value of this class has the paper's."""
    task: str = "paper"
    """Name of a task that is shipped, or path of a TOML file."""
    learner: LearnerOptions = field(default_factory=LearnerOptions)
    arbitration: ArbitrationOptions = field(default_factory=ArbitrationOptions)
    accumulation: AccumulationOptions = field(default_factory=AccumulationOptions)
    session: SessionOptions = field(default_factory=SessionOptions)
    correction: CorrectionOptions = field(default_factory=CorrectionOptions)
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
        said = self.learner.build().check_parameters() + check_thresholds(
            w_th=self.arbitration.w_th, d=self.arbitration.d, w_gen=self.learner.w_gen
        )
        kind, is_coupled = self.arbitration.kind, self.session.coupling is Coupling.COUPLED
        if kind in (ArbitrationKind.ERROR, ArbitrationKind.SUCCESS) and is_coupled:
            said.append(
                f'arbitration.kind = "{kind.value}" with session.coupling = "coupled": a spring drags the '
                "handle towards the skill while C < 1, so that the human's command is only estimated and "
                'shrinks the error by itself; choose session.coupling = "uncoupled"'
            )
        if self.correction.insist_force > 0.0 and not is_coupled:
            said.append(
                f"correction.insist_force = {self.correction.insist_force:g} has no effect with "
                'session.coupling = "uncoupled": a handle that is free cannot be pushed against'
            )
        return said


def load_options(
    path: Path | None = None, overrides: Mapping[str, str] | None = None
) -> Merged[TeachOptions]:
    """The configuration of a file and of overrides, above the defaults of the method that they name.

    Args:
        path: TOML file; None for none.
        overrides: Dotted key to text, as in ``--set method=confident``.

    Raises:
        ConfigurationError: As for `tools.config.load`.
    """
    return merge(TeachOptions, path, overrides, presets=Presets("method", PRESETS))


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
        arbitration=options.arbitration.build(task.reference_force),
        accumulator=Accumulator(
            options.accumulation.N_acc,
            options.accumulation.downsample,
            hindsight=round(options.session.hindsight / TICK_S),
            rng=rng,
        ),
        w_th=options.arbitration.w_th,
        assist_stiffness=options.modes.assist_stiffness,
        options=options.session,
        correction=options.correction,
    )
