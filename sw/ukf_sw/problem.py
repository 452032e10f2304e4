"""An estimation problem, described once: states, models, sensors, noise, first estimate, and data.

::

    problem = Problem(
        name="cart",
        states={"position": "m", "speed": "m/s"},
        f=f,
        Q=Q,
        process_noise=Noise.ADDITIVE,
        sensors={"gps": Sensor(h_gps, R=[[4.0]]), "odometer": Sensor(h_odometer, R=[[0.01]])},
        x0=[0.0, 0.0],
        P0=np.eye(2),
    )
    ukf = UnscentedKalmanFilter(problem, "golden")

Everything takes it: the filter, runs, co-simulation, sweeps, export, the commands.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.arrays import as_covariance, as_indices, as_vector, is_masked
from ukf_sw.errors import describe
from ukf_sw.extras import MissingExtraError
from ukf_sw.models import ObservationModel, ProcessModel, check_takes, wrap
from ukf_sw.spec.fields import as_bool, as_int, parameters_of
from ukf_sw.spec.float_format import BINARY32, FloatFormat
from ukf_sw.spec.model_programs import NO_MODELS, CoreModels
from ukf_sw.spec.parameters import Form, Noise, UkfParams

__all__ = ["ONLY", "Data", "Problem", "Sensor", "of_sensor"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Name of the sensor of a problem that has one, and gives it none.
ONLY = "sensor"


def of_sensor(what: str, name: str) -> str:
    """What is of a sensor, in messages: "R of gps"; "R" of a sensor that was given no name."""
    return what if name == ONLY else f"{what} of {name}"


def _array(name: str, value: Any) -> NDArray[Any]:
    """Check data of a sensor: numbers, or bool."""
    array = np.ma.asarray(value) if is_masked(value) else np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}")
    return array


@dataclass(frozen=True, eq=False)
class Sensor:
    """What is observed together: rows of Z with a model, a noise and an UPDATE of their own.

    Parameters
    ----------
    h
        Observation model; see :mod:`ukf_sw.models`.
    R
        Covariance of its noise v, shape (r, r); None is no noise.
    m
        Number of observations. None: as many as there are names, or as h gives for the first
        estimate.
    observations
        Names and units of the observations, as ``{"range": "m", "bearing": "rad"}``; or names.
    angles
        Which observations are angles, in radians: indices or names.
    """

    h: ObservationModel
    _: KW_ONLY
    R: ArrayLike | None = None
    m: int | None = None
    observations: Mapping[str, str] | Sequence[str] = ()
    angles: Sequence[int | str] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """K steps of data, recorded or simulated.

    Step k predicts with ``inputs[k]``, then updates with every sensor that was sampled, in their
    order in the problem. The estimate after it belongs to ``times[k]`` and to ``truth[k]``.

    Parameters
    ----------
    times
        Time of each step, shape (K,), in seconds.
    measurements
        Observations of each sensor, by its name, shape (K, m) each; the array alone if there is one
        sensor. Elements that NumPy has masked were not sampled.
    sampled
        Which of them were sampled, as `measurements`; None: those that are not NaN. A step without
        any is a predict only.
    inputs
        Input u of each predict, K of them; None gives ``u=None``.
    observation_arguments
        Keyword arguments of the h of every sensor, K of them; None is none.
    truth
        True states, or whatever the problem's `error` compares with, shape (K, ...). None if it is
        not known; then there are no errors.
    judged
        Steps whose errors count, shape (K,); None is all. Records have steps without truth.

    Raises
    ------
    TypeError
        If the data are no arrays or sequences.
    ValueError
        If the data are not K steps long, or the times are not finite and rising.
    """

    times: Array
    measurements: Mapping[str, Array] | Array
    sampled: Mapping[str, Mask] | Mask | None = None
    inputs: Sequence[Any] | Array | None = None
    observation_arguments: Sequence[Mapping[str, Any]] | None = None
    truth: Array | None = None
    judged: Mask | None = None

    def __post_init__(self) -> None:
        for each in fields(self):
            given: Any = getattr(self, each.name)
            if isinstance(given, Mapping):
                for name, part in cast("Mapping[str, Any]", given).items():
                    self._check(of_sensor(each.name, name), part)
            elif given is not None or each.name in ("times", "measurements"):
                self._check(each.name, given)
        object.__setattr__(self, "times", self._rising(self.times))

    @staticmethod
    def _rising(given: ArrayLike) -> Array:
        """Give times as an array, if they are some."""
        found = np.asarray(given)
        if found.dtype.kind not in "fiu" or found.ndim != 1:
            raise ValueError(f"times must be a vector of numbers, not {given!r}")
        times = found.astype(np.float64)
        if not np.isfinite(times).all():
            step = int(np.isfinite(times).argmin())
            raise ValueError(f"times must be finite, not {times[step]} at step {step}")
        rises = np.diff(times) > 0.0
        if not rises.all():
            step = int(rises.argmin())
            raise ValueError(
                f"times must rise, not go from {times[step]} at step {step} to {times[step + 1]}"
            )
        return times

    def _check(self, name: str, data: Any) -> None:
        """Check that data have as many entries as there are times."""
        if not hasattr(data, "__len__") or getattr(data, "shape", None) == ():
            raise TypeError(f"{name} must have an entry for each step, not {data!r}")
        if len(data) != self.steps:
            raise ValueError(f"{name} must have {self.steps} steps, not {len(data)!r}")

    @property
    def steps(self) -> int:
        """Number of steps, K."""
        return len(self.times)

    def first(self, steps: int) -> "Data":
        """Give the first steps.

        Raises
        ------
        ValueError
            If there are not as many.
        """
        if not 1 <= steps <= self.steps:
            raise ValueError(f"steps must be between 1 and {self.steps}, not {steps!r}")

        def cut(data: Any) -> Any:
            if isinstance(data, Mapping):
                parts = cast("Mapping[str, Any]", data)
                return {name: part[:steps] for name, part in parts.items()}
            return None if data is None else data[:steps]

        return Data(**{each.name: cut(getattr(self, each.name)) for each in fields(self)})


def _named(given: Mapping[str, str] | Sequence[str], what: str) -> dict[str, str]:
    """Units by name, and a check that the names differ."""
    if isinstance(given, str) or not isinstance(cast("object", given), (Mapping, Sequence)):
        raise TypeError(f"{what} must be names and units, as {{'a': 'm'}}, not {given!r}")
    named = dict(given) if isinstance(given, Mapping) else dict.fromkeys(given, "")
    for text in (*named, *named.values()):
        if not isinstance(cast("object", text), str):
            raise TypeError(f"{what} must have names and units that are text, not {text!r}")
    if len(named) < len(given):
        raise ValueError(f"{what} must have different names, not {tuple(given)!r}")
    return named


def _width(inputs: Sequence[Any] | Array | None) -> int | None:
    """How many numbers each input is; None if inputs are no numbers."""
    try:
        shape = np.asarray(inputs, dtype=np.float64).shape
    except (TypeError, ValueError):
        return None
    return None if inputs is None or len(shape) > 2 else (*shape, 1)[1]


def _check_radians(name: str, angles: Sequence[int], units: Mapping[str, str]) -> None:
    """Check the units of angles, where there are some."""
    for row in angles:
        label, unit = [*units.items()][row] if units else ("", "")
        if unit not in ("", "rad"):
            raise ValueError(f"{name} must be in rad, and {label} is in {unit!r}")


def _rows(name: str, value: ArrayLike | None) -> int:
    """Number of rows of an array as it was given; None has none."""
    if value is None:
        return 0
    try:
        shape = np.shape(value)
    except ValueError as error:
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}") from error
    if not shape:
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}")
    return shape[0]


def _covariance_of(sensor: Sensor) -> Array:
    """R of a sensor that has been completed."""
    return cast("Array", sensor.R)


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """An estimation problem.

    Parameters
    ----------
    name
        Name on the command line and in reports.
    f
        Process model; see :mod:`ukf_sw.models`.
    sensors
        By name, in the order of their rows; or the only one.
    x0
        First estimate, shape (n,).
    P0
        Its covariance, shape (n, n), positive semidefinite; positive definite for a core of the
        covariance form.
    Q
        Covariance of the process noise w, shape (q, q), positive semidefinite. Without it there is
        no noise.
    process_noise, observation_noise
        How w, and the v of every sensor, enter the models.
    states
        Names and units of the states, as ``{"position": "m"}``; or names.
    state_angles
        Which states are angles, in radians: indices or names.
    inputs
        Names and units of the inputs, if u is an array of them; or names.
    vectorized
        Whether the models take all sigma points at once.
    redraw
        Whether every predict ends with drawing new sigma points; None: if there is additive process
        noise. It costs a factorisation and, on a core, reading the points once more.
    W0
        Weight of sigma point 0, in [0, 1).
    form, format, pes, models
        Of a core for it, as :class:`ukf_sw.spec.parameters.UkfParams` has them.
    data
        Data, or a function that makes them: ``data(seed, steps)``, where None is all steps.
    error
        Function of estimates (K, n) and truth (K, ...) that gives errors (K, e). None: their
        difference, of angles within half a turn.
    error_names, error_units
        Name and unit of each error, e each; by default those of the states.
    settled
        Time from which on errors count, in seconds: the filter has settled by then.
    limit
        What the first error should stay below, in its unit; None is nothing.

    Raises
    ------
    TypeError
        If something is of the wrong kind.
    ValueError
        If something has a wrong shape or value, or data of a sensor is missing or nobody's; the
        message names the rule and the value.
    """

    name: str
    f: ProcessModel
    sensors: Mapping[str, Sensor] | Sensor
    x0: Array
    P0: Array
    Q: Array = field(default_factory=lambda: np.zeros((0, 0)))
    process_noise: Noise = Noise.AUGMENTED
    observation_noise: Noise = Noise.AUGMENTED
    states: Mapping[str, str] | Sequence[str] = ()
    state_angles: Sequence[int | str] = ()
    inputs: Mapping[str, str] | Sequence[str] = ()
    vectorized: bool = False
    redraw: bool | None = None
    W0: float = 0.0
    form: Form = Form.SQUARE_ROOT
    format: FloatFormat = BINARY32
    pes: int = 1
    models: CoreModels = NO_MODELS
    data: Data | Callable[[int, int | None], Data] | None = None
    error: Callable[[Array, Array], Array] | None = None
    error_names: tuple[str, ...] = ()
    error_units: tuple[str, ...] = ()
    settled: float = float("-inf")
    limit: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(cast("object", self.name), str) or not self.name:
            raise TypeError(f"name must be text, not {self.name!r}")
        if not callable(self.f):
            raise TypeError(f"f must be callable, not {self.f!r}")
        check_takes(self.f, "process model f", ("x", "w", "u"))
        for name in ("process_noise", "observation_noise", "form", "format"):
            self._set(name, parameters_of(UkfParams)[name].check(getattr(self, name)))
        self._set("vectorized", as_bool("vectorized", self.vectorized))
        if self.redraw is not None:
            self._set("redraw", as_bool("redraw", self.redraw))
        if len(self.error_names) != len(self.error_units):
            raise ValueError(
                f"error_units must have {len(self.error_names)} entries, "
                f"not {len(self.error_units)!r}"
            )
        self._set("states", _named(self.states, "states"))
        self._set("inputs", _named(self.inputs, "inputs"))
        n = len(self.states) or _rows("x0", self.x0)
        self._set("x0", as_vector(self.x0, "x0", n))
        definite = self.form is Form.COVARIANCE
        self._set("P0", as_covariance(self.P0, "P0", n, definite=definite))
        q = _rows("Q", self.Q)
        if self.process_noise is Noise.ADDITIVE and q:
            q = n
        self._set("Q", as_covariance(self.Q, "Q", q))
        self._set(
            "state_angles", as_indices(self.state_angles, "state_angles", n, tuple(self.states))
        )
        _check_radians(
            "state_angles",
            cast("tuple[int, ...]", self.state_angles),
            cast("dict[str, str]", self.states),
        )
        self._set("sensors", self._complete_sensors())
        _ = self.params  # it is checked there that there is such a core
        if isinstance(self.data, Data):
            self._set("data", self._complete_data(self.data))
        elif self.data is not None and not callable(self.data):
            raise TypeError(f"data must be Data or a function that makes them, not {self.data!r}")
        if self.error is not None and not self.error_names:
            raise ValueError("error_names must name what error gives, a column each, not ()")
        if self.error is None and not self.error_names:
            named = cast("dict[str, str]", self.states) or {f"x[{i}]": "" for i in range(n)}
            self._set("error_names", tuple(named))
            self._set("error_units", tuple(named.values()))

    def _set(self, name: str, value: Any) -> None:
        """Keep an argument as what it means."""
        object.__setattr__(self, name, value)

    # Sensors.

    def _complete_sensors(self) -> dict[str, Sensor]:
        """Fill in what the sensors left open, and check them."""
        given = self.sensors
        if isinstance(given, Sensor):
            given = {ONLY: given}
        if not isinstance(cast("object", given), Mapping) or not given:
            raise TypeError(
                f"sensors must be a Sensor, or some of them by name, not {self.sensors!r}"
            )
        additive = self.observation_noise is Noise.ADDITIVE
        noisy = False
        for name, sensor in given.items():
            self._check_sensor(name, sensor)
            noisy |= _rows(of_sensor("R", name), sensor.R) > 0
        return {
            name: self._complete(name, sensor, noisy=additive and noisy)
            for name, sensor in given.items()
        }

    @staticmethod
    def _check_sensor(name: str, sensor: Sensor) -> None:
        """Check that it is one."""
        if not (isinstance(cast("object", name), str) and name.isidentifier()):
            raise ValueError(f"sensors must have names like gps, not {name!r}")
        if not isinstance(cast("object", sensor), Sensor):
            raise TypeError(f"sensors must be of the class Sensor, and {name} is not: {sensor!r}")
        h = of_sensor("h", name)
        if not callable(sensor.h):
            raise TypeError(f"{h} must be callable, not {sensor.h!r}")
        check_takes(sensor.h, f"observation model {h}", ("x", "v"))

    def _complete(self, name: str, sensor: Sensor, *, noisy: bool) -> Sensor:
        """Fill in what a sensor left open; `noisy`: R is of the size of the observations."""
        names = _named(sensor.observations, of_sensor("observations", name))
        r = _rows(of_sensor("R", name), sensor.R)
        if sensor.m is not None:
            m = as_int(of_sensor("m", name), sensor.m)
            if m < 1:
                raise ValueError(f"{of_sensor('m', name)} must be at least 1, not {m!r}")
        else:
            m = len(names) or self._count(name, sensor, r)
        if names and m != len(names):
            raise ValueError(
                f"{of_sensor('m', name)} must be {len(names)}, the number of names, not {m!r}"
            )
        angles = as_indices(sensor.angles, of_sensor("angles", name), m, tuple(names))
        _check_radians(of_sensor("angles", name), angles, names)
        covariance = sensor.R
        if noisy:
            covariance, r = (np.zeros((m, m)) if covariance is None else covariance), m
        stem = "z" if name == ONLY else name
        return Sensor(
            sensor.h,
            R=as_covariance(covariance, of_sensor("R", name), r),
            m=m,
            observations=names or {f"{stem}[{i}]" if m > 1 else stem: "" for i in range(m)},
            angles=angles,
        )

    def _count(self, name: str, sensor: Sensor, r: int) -> int:
        """Call the model of a sensor for the first estimate, and count what it gives."""
        x, v = self.x0.copy(), np.zeros(r)
        if self.vectorized:
            x, v = x[:, np.newaxis], v[:, np.newaxis]
        try:
            result = np.asarray(sensor.h(x, v))
        except Exception as error:
            raise ValueError(
                f"{of_sensor('h', name)} must take the first estimate and zeros as v, to count its "
                f"observations; give m, or their names, if it cannot: "
                f"{type(error).__name__}: {error}"
            ) from error
        if result.ndim != 1 + self.vectorized or not result.shape[0]:
            raise ValueError(
                f"{of_sensor('h', name)} must return a vector of observations for the first "
                f"estimate, not the shape {result.shape!r}"
            )
        return result.shape[0]

    @property
    def _sensors(self) -> dict[str, Sensor]:
        return cast("dict[str, Sensor]", self.sensors)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of their rows."""
        return tuple(self._sensors)

    def sensor(self, name: str) -> Sensor:
        """Give a sensor, with all that it left open filled in; raises as :meth:`number_of`."""
        return self._sensors[self.sensor_names[self.number_of(name)]]

    def number_of(self, name: str | None) -> int:
        """Number of a sensor; of the only one if no name is given.

        Raises
        ------
        TypeError
            If no name is given, and there are several.
        ValueError
            If there is none of that name.
        """
        names = self.sensor_names
        if name is None:
            if len(names) > 1:
                raise TypeError(f"sensor must be one of {', '.join(names)}, not None")
            return 0
        if name not in names:
            raise ValueError(f"sensor must be one of {', '.join(names)}, not {name!r}")
        return names.index(name)

    def terms_of(self, number: int) -> range:
        """Rows of V, or of R, that are noise of a sensor."""
        sizes = [len(_covariance_of(sensor)) for sensor in self._sensors.values()]
        first = sum(sizes[:number])
        return range(first, first + sizes[number])

    @cached_property
    def R(self) -> Array:
        """Covariance of the noise of all sensors, shape (r, r): a block of each."""
        R = np.zeros((self.params.r, self.params.r))
        for number, sensor in enumerate(self._sensors.values()):
            own = slice(self.terms_of(number).start, self.terms_of(number).stop)
            R[own, own] = _covariance_of(sensor)
        return R

    @cached_property
    def params(self) -> UkfParams:
        """What a core for it computes."""
        sensors = self._sensors.values()
        rows = tuple(cast("int", sensor.m) for sensor in sensors)
        return UkfParams(
            n=len(self.x0),
            m=sum(rows),
            q=len(self.Q),
            r=sum(len(_covariance_of(sensor)) for sensor in sensors),
            sensors=rows,
            process_noise=self.process_noise,
            observation_noise=self.observation_noise,
            W0=self.W0,
            form=self.form,
            format=self.format,
            pes=self.pes,
            models=self.models,
        )

    @property
    def redraws(self) -> bool:
        """Whether every predict ends with drawing new sigma points."""
        return self.params.additive_q > 0 if self.redraw is None else self.redraw

    def for_core(self, params: UkfParams) -> "Problem":
        """The same problem for another core.

        Raises
        ------
        ValueError
            If that has other sizes or kinds of noise.
        """
        for entry in parameters_of(UkfParams).values():
            wanted, found = getattr(self.params, entry.name), getattr(params, entry.name)
            if entry.meaning.problem and wanted != found:
                raise ValueError(
                    f"{entry.name} of a core for {self.name} must be {wanted!r}, not {found!r}"
                )
        return replace(
            self, W0=params.W0, form=params.form, format=params.format, pes=params.pes,
            models=params.models,
        )  # fmt: skip

    # Data.

    def _complete_data(self, data: Data) -> Data:
        """Give the parts of each sensor by name, and check them."""
        measurements = self._by_sensor("measurements", data.measurements, data.steps)
        hidden = {name: np.ma.getmaskarray(part) for name, part in measurements.items()}
        measurements = {name: np.ma.filled(part, np.nan) for name, part in measurements.items()}
        if data.sampled is None:
            sampled = {name: ~np.isnan(part) for name, part in measurements.items()}
        else:
            sampled = self._by_sensor("sampled", data.sampled, data.steps)
            sampled = {
                name: part.astype(np.bool_) & ~hidden[name] for name, part in sampled.items()
            }
        shape = data.steps, len(self.x0)
        if self.error is None and data.truth is not None and np.shape(data.truth) != shape:
            raise ValueError(
                f"truth must have the shape {shape} to be compared with the states, not "
                f"{np.shape(data.truth)}: give an error function"
            )
        width = _width(data.inputs)
        if self.inputs and width is not None and width != len(self.inputs):
            raise ValueError(
                f"inputs must have {len(self.inputs)} numbers in each step, for "
                f"{', '.join(self.inputs)}, not {width}"
            )
        if self.inputs and width is not None:
            numbers = np.asarray(data.inputs, dtype=np.float64).reshape(data.steps, width)
            if not np.isfinite(numbers).all():
                step, k = (int(i) for i in np.argwhere(~np.isfinite(numbers))[0])
                raise ValueError(
                    f"inputs must be finite, not {float(numbers[step, k])!r} in "
                    f"{[*self.inputs][k]} of step {step}"
                )
        return replace(data, measurements=measurements, sampled=sampled)

    def _by_sensor(self, what: str, given: Any, steps: int) -> dict[str, Any]:
        """A part of the data by sensor, of which each has its own."""
        names = self.sensor_names
        if not isinstance(given, Mapping):
            if len(names) > 1:
                raise ValueError(f"{what} must be by sensor, {', '.join(names)}, not one array")
            given = dict.fromkeys(names, given)
        found = cast("Mapping[str, Any]", given)
        if set(found) != set(names):
            raise ValueError(
                f"{what} must be of {', '.join(names)}, not {', '.join(map(str, found))}"
            )
        parts = {name: _array(of_sensor(what, name), found[name]) for name in names}
        for name, part in parts.items():
            sensor = self._sensors[name]
            shape = steps, cast("int", sensor.m)
            if part.shape != shape:
                raise ValueError(
                    f"{of_sensor(what, name)} must have the shape {shape}, not {part.shape}: "
                    f"columns of {', '.join(sensor.observations)}"
                )
        return parts

    @property
    def record(self) -> Data:
        """The data, of each sensor by name.

        Raises
        ------
        ValueError
            If there are none, or only a function that makes them: see :meth:`with_data`.
        """
        if not isinstance(self.data, Data):
            missing = (
                "None: it needs data, or a log"
                if self.data is None
                else "the function that makes them: use with_data()"
            )
            raise ValueError(f"data of the problem {self.name!r} must be Data, not {missing}")
        return self.data

    def with_data(self, seed: int = 0, steps: int | None = None) -> "Problem":
        """The same problem with data of so many steps; None is all.

        Parameters
        ----------
        seed
            Seed of data that are simulated; records disregard it.
        steps
            How many steps.

        Raises
        ------
        ValueError
            If there are no data, or not as many steps.
        """
        if not callable(self.data):
            return self if steps is None else replace(self, data=self.record.first(steps))
        what = f"data of the problem {self.name!r}"
        try:
            made = cast("object", self.data(seed, steps))
        except MissingExtraError:
            raise
        except Exception as error:
            count = "all" if steps is None else steps
            raise ValueError(
                f"{what} must be made by data(seed, steps), and for seed {seed} and {count} steps "
                f"it raised {describe(error)}"
            ) from error
        if not isinstance(made, Data):
            raise TypeError(f"{what} must be Data, and its function gave {made!r}")
        return replace(self, data=made if steps is None else made.first(steps))

    def samples(self, sensor: str | None = None) -> tuple[Array, Mask]:
        """Give the observations of a sensor, and which were sampled, shape (K, m) each.

        Parameters
        ----------
        sensor
            Its name; None is the only one.

        Raises
        ------
        TypeError, ValueError
            If the name is wrong, or there are no data.
        """
        name = self.sensor_names[self.number_of(sensor)]
        measurements = cast("dict[str, Array]", self.record.measurements)
        return measurements[name], cast("dict[str, Mask]", self.record.sampled)[name]

    @property
    def steps(self) -> int:
        """Number of steps of the data, K."""
        return self.record.steps

    @property
    def times(self) -> Array:
        """Time of each step, shape (K,), in seconds."""
        return self.record.times

    def errors_of(self, x: Array) -> Array:
        """Compare estimates of the first steps, shape (k, n), with the truth; gives (k, e).

        Raises
        ------
        ValueError
            If there is no truth, or the function `error` fails or gives another shape.
        """
        truth = self.record.truth
        if truth is None:
            raise ValueError(
                f"the problem {self.name!r} must have truth, not None, to have errors: it can be "
                "run, but what comes out cannot be judged"
            )
        if self.error is not None:
            return self._compared(x, truth[: len(x)])
        difference = x - truth[: len(x)]
        for row in cast("tuple[int, ...]", self.state_angles):
            difference[:, row] = wrap(difference[:, row], 0.0)
        return difference

    def _compared(self, x: Array, truth: Array) -> Array:
        """Call the function `error`, and check what it gives."""
        assert self.error is not None
        what = f"error of the problem {self.name!r}"
        try:
            errors = np.asarray(self.error(x, truth), dtype=np.float64)
        except Exception as error:
            raise ValueError(
                f"{what} must compare x of shape {x.shape} with the truth of shape "
                f"{np.shape(truth)}, and raised {describe(error)}"
            ) from error
        shape = len(x), len(self.error_names)
        if errors.shape != shape:
            raise ValueError(
                f"{what} must give the shape {shape}, a column for each of error_names "
                f"({', '.join(self.error_names)}), not {errors.shape}"
            )
        return errors
