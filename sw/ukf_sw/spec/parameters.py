"""Parameters of the core: what it computes, and how it is built."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

from ukf_sw.spec.fields import NO_PARAMETER, Meaning, check_parameters
from ukf_sw.spec.float_format import BINARY32, FloatFormat
from ukf_sw.spec.model_programs import NO_MODELS, CoreModels

__all__ = ["Form", "Noise", "Pipeline", "UkfParams"]

MAX_SIZE = 32


class Form(Enum):
    """How the update is computed."""

    SQUARE_ROOT = "square-root"  #: Gram-Schmidt over the weighted residuals; the default.
    COVARIANCE = "covariance"  #: The 2018 paper's LDL^T of covariances and P - K Pxz^T.


class Noise(Enum):
    """How a noise enters its model."""

    AUGMENTED = "augmented"  #: As an argument of the model; it has sigma points of its own.
    ADDITIVE = "additive"  #: Added to the model's result; it has none.


def _size(doc: str, *, low: int) -> Meaning:
    """A size of the models."""
    return Meaning(
        doc, low=low, high=MAX_SIZE, words="{label} = {value}", always=True, problem=True
    )


def _stages(doc: str, *, high: int, label: str) -> Meaning:
    """A pipeline depth."""
    return Meaning(doc, low=1, high=high, label=label)


@dataclass(frozen=True, kw_only=True)
class UkfParams:
    """What a core computes. Two cores with equal parameters give equal bits.

    Parameters
    ----------
    n
        Number of states, 1 to 32.
    m
        Number of observations, 1 to 32.
    q, r
        Number of process and of observation noise terms, 0 to 32. Of an additive noise there are
        as many as states (observations), or none.
    sensors
        Number of observations of each sensor, in the order of their rows. Each sensor has an
        UPDATE of its own. Empty, the default, is one sensor with all of them.
    process_noise, observation_noise
        How they enter the models.
    W0
        Weight of sigma point 0, in [0, 1). The points lie at the radius sqrt(M / (1 - W0)). With 0,
        the default, there is no point 0: no model is evaluated there.
    form
        How the update is computed.
    format
        Number format.
    pes
        Number of processing elements, 1 to :attr:`columns`. It decides the order of summation,
        so it belongs to what is computed.
    models
        Models that the core evaluates. By default all models run in software.

    Raises
    ------
    TypeError
        If a parameter is of the wrong kind.
    ValueError
        If a parameter is out of range, or a model is not one of these sizes.
    """

    n: Annotated[int, _size("States.", low=1)]
    m: Annotated[int, _size("Observations.", low=1)]
    q: Annotated[int, _size("Process noise terms.", low=0)] = 0
    r: Annotated[int, _size("Observation noise terms.", low=0)] = 0
    sensors: Annotated[
        tuple[int, ...],
        Meaning(
            "Observations of each sensor, as 3+3; one: a single sensor.",
            low=1,
            high=MAX_SIZE,
            words="{label} {value}",
            problem=True,
        ),
    ] = ()
    process_noise: Annotated[Noise, Meaning("How process noise enters.", problem=True)] = (
        Noise.AUGMENTED
    )
    observation_noise: Annotated[Noise, Meaning("How observation noise enters.", problem=True)] = (
        Noise.AUGMENTED
    )
    W0: Annotated[
        float, Meaning("Weight of sigma point 0, in [0, 1).", words="{label} = {value}")
    ] = 0.0
    form: Annotated[
        Form, Meaning("How the update is computed.", words="{value} form", always=True)
    ] = Form.SQUARE_ROOT
    format: Annotated[FloatFormat, Meaning("Number format.", words="{value}", always=True)] = (
        BINARY32
    )
    pes: Annotated[
        int, Meaning("Processing elements.", low=1, words="{value} PE{s}", always=True)
    ] = 1
    models: CoreModels = field(default=NO_MODELS, repr=False, metadata=NO_PARAMETER)

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.sensors == (self.m,):  # so that equal cores have equal parameters
            object.__setattr__(self, "sensors", ())
        if sum(self.sensor_rows) != self.m:
            raise ValueError(
                f"sensors must have m = {self.m} observations together, not {self.sensors!r}"
            )
        if not 0.0 <= self.W0 < 1.0:
            raise ValueError(f"W0 must be at least 0 and less than 1, not {self.W0!r}")
        smallest = self.format.min_normal
        if smallest > self.W1:
            raise ValueError(
                f"W0 must leave each other sigma point a weight of at least {smallest!r}, the "
                f"smallest in {self.format.name}, not {self.W0!r}"
            )
        if self.process_noise is Noise.ADDITIVE and self.q not in (0, self.n):
            raise ValueError(f"q must be 0 or n = {self.n} for additive noise, not {self.q!r}")
        if self.observation_noise is Noise.ADDITIVE and self.r not in (0, self.m):
            raise ValueError(f"r must be 0 or m = {self.m} for additive noise, not {self.r!r}")
        if self.pes > self.columns:
            raise ValueError(
                f"pes must be between 1 and the number of columns, {self.columns}, not {self.pes!r}"
            )
        self._check_models()

    def _check_models(self) -> None:
        f, h = self.models.f, self.models.h
        rows = [("f", len(f.outputs), self.n)] if f is not None else []
        if h and len(h) != len(self.sensor_rows):
            raise ValueError(f"models must have h of {len(self.sensor_rows)} sensors, not {len(h)}")
        for programs, expected in zip(h, self.sensor_rows if h else (), strict=True):
            rows += [(program.title, len(program.outputs), expected) for program in programs]
        for title, found, expected in rows:
            if found != expected:
                raise ValueError(f"{title} of models must have {expected} rows, not {found}")
        for program in self.models:
            if program.fmt != self.format:
                raise ValueError(
                    f"{program.title} of models must be in the format {self.format.name}, not "
                    f"{program.fmt.name}"
                )

    @property
    def sensor_rows(self) -> tuple[int, ...]:
        """Number of observations of each sensor, also where there is one."""
        return self.sensors or (self.m,)

    @property
    def largest_sensor(self) -> int:
        """Number of observations of the sensor that has most."""
        return max(self.sensor_rows)

    def rows_of(self, sensor: int) -> range:
        """Rows of the observations of a sensor."""
        first = sum(self.sensor_rows[:sensor])
        return range(first, first + self.sensor_rows[sensor])

    @property
    def augmented_q(self) -> int:
        """Process noise terms that have sigma points."""
        return self.q if self.process_noise is Noise.AUGMENTED else 0

    @property
    def augmented_r(self) -> int:
        """Observation noise terms that have sigma points."""
        return self.r if self.observation_noise is Noise.AUGMENTED else 0

    @property
    def additive_q(self) -> int:
        """Process noise terms that stand as columns beside the sigma points."""
        return self.q - self.augmented_q

    @property
    def additive_r(self) -> int:
        """Observation noise terms that are added to the observations."""
        return self.r - self.augmented_r

    @property
    def columns_of_r(self) -> int:
        """Columns of additive observation noise beside the sigma points; sensors share them."""
        return self.largest_sensor if self.additive_r else 0

    @property
    def M(self) -> int:
        """Length of the augmented state: x, then w, then v."""
        return self.n + self.augmented_q + self.augmented_r

    @property
    def N(self) -> int:
        """Number of sigma points, point 0 included."""
        return self.M + 2

    @property
    def points(self) -> range:
        """Numbers of the sigma points that have a weight: without W0 all but point 0.

        What has no weight has no influence, so nothing computes with it.
        """
        return range(0 if self.W0 else 1, self.N)

    @property
    def centre(self) -> int:
        """Number of the sigma point that angles are wrapped to.

        It is point 0, which equals the mean; without W0 it is the last point, which of all others
        differs from the mean in the fewest elements: only in the last one of x, w and v together.
        """
        return 0 if self.W0 else self.N - 1

    @property
    def W1(self) -> float:
        """Weight of every sigma point but point 0 (2018, equation 5)."""
        return (1.0 - self.W0) / (self.M + 1)

    @property
    def columns(self) -> int:
        """Columns of the rows: sigma points with weight, right-hand side, additive noise terms."""
        return len(self.points) + 1 + self.additive_q + self.columns_of_r


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """How a core is built: pipeline depths in clocks. Results never depend on them.

    Parameters
    ----------
    multiply, add, reciprocal_sqrt
        Latency of the floating-point units.

    Raises
    ------
    TypeError
        If a depth is not an int.
    ValueError
        If a depth is out of range.
    """

    multiply: Annotated[
        int, _stages("Latency of a product in clocks.", high=8, label="multiply_stages")
    ] = 2
    add: Annotated[int, _stages("Latency of a sum in clocks.", high=8, label="add_stages")] = 2
    reciprocal_sqrt: Annotated[
        int, _stages("Latency of 1/sqrt in clocks.", high=16, label="reciprocal_sqrt_stages")
    ] = 3

    def __post_init__(self) -> None:
        check_parameters(self)
