"""A core as a whole, and the one way to describe it: for people, for files and as JSON."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from ukf_sw.spec.fields import Meaning, Parameter, parameters_of
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import CoreModels
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = ["PARAMETERS", "Core", "Placement"]


class Placement(Enum):
    """Models that a core evaluates."""

    SOFTWARE = "software"  #: None of them.
    CORE = "core"  #: All of them.
    F = "f"  #: The process model.
    H = "h"  #: The observation models.

    @classmethod
    def of(cls, models: CoreModels) -> "Placement":
        """Tell which of them a core has."""
        if models.f is not None:
            return cls.CORE if models.h else cls.F
        return cls.H if models.h else cls.SOFTWARE


_MODELS = Parameter(
    name="models",
    kind=Placement,
    meaning=Meaning("Models that the core evaluates: all, f, h, or none.", words="models {value}"),
    default=Placement.SOFTWARE,
)

#: Every parameter of a core by label, in order: what it computes, then how it is built.
PARAMETERS: dict[str, Parameter] = {
    **parameters_of(UkfParams),
    _MODELS.label: _MODELS,
    **parameters_of(Pipeline),
}
if len(PARAMETERS) < 1 + len(parameters_of(UkfParams)) + len(parameters_of(Pipeline)):
    raise TypeError("UkfParams and Pipeline must have no label in common")


@dataclass(frozen=True, kw_only=True)
class Core:
    """A core.

    Parameters
    ----------
    params, pipeline
        What it computes, and how it is built.
    problem
        Name of the problem that it is for, or None.
    redraw
        Whether the filter on it draws new sigma points after every predict; None: if there is
        additive process noise.
    """

    params: UkfParams
    pipeline: Pipeline = field(default_factory=Pipeline)
    problem: str | None = None
    redraw: bool | None = None

    @classmethod
    def from_values(
        cls,
        values: Mapping[str, Any],
        problem: str | None = None,
        *,
        redraw: bool | None = None,
        place: Callable[[str, str, FloatFormat], CoreModels] | None = None,
    ) -> "Core":
        """Make a core of parameters by label; those that are missing have their defaults.

        Parameters
        ----------
        values
            Parameters by label.
        problem, redraw
            As above.
        place
            What makes programs of the models of a problem:
            :func:`ukf_sw.problems.placing.core_models`.

        Raises
        ------
        TypeError
            If there is no such parameter, one without default is missing, or one is of the wrong
            kind.
        ValueError
            If there is no such core.
        """
        for label in values:
            if label not in PARAMETERS:
                known = ", ".join(PARAMETERS)
                raise TypeError(f"parameter must be one of {known}, not {label!r}")
        params, pipeline = (
            {entry.name: values[label] for label, entry in parameters_of(block).items()
             if label in values}
            for block in (UkfParams, Pipeline)
        )  # fmt: skip
        placement = _MODELS.check(values.get("models", _MODELS.default))
        if placement is not Placement.SOFTWARE:
            if problem is None or place is None:
                raise ValueError(
                    f"models must be in software without a problem, not {placement.value!r}"
                )
            params["models"] = place(problem, placement.value, UkfParams(**params).format)
        return cls(
            params=UkfParams(**params),
            pipeline=Pipeline(**pipeline),
            problem=problem,
            redraw=redraw,
        )

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Core":
        """Make the core that a :meth:`record` describes.

        Raises
        ------
        ValueError
            If it has models, and the record not their programs.
        """
        values = _from_record(UkfParams, record["parameters"])
        models = record.get("models")
        if models is not None:
            if "programs" not in models:
                raise ValueError("record must have the programs of the models of a core")
            values["models"] = CoreModels.from_record(models["programs"], values["format"])
        return cls(
            params=UkfParams(**values),
            pipeline=Pipeline(**_from_record(Pipeline, record["pipeline"])),
        )

    def values(self) -> dict[str, Any]:
        """Parameters by label."""
        values = {
            label: getattr(block, entry.name)
            for block in (self.params, self.pipeline)
            for label, entry in parameters_of(type(block)).items()
        }
        values["models"] = Placement.of(self.params.models)
        return {label: values[label] for label in PARAMETERS}

    def record(self, *, programs: bool = False) -> dict[str, dict[str, Any]]:
        """Describe the core, but not what it is for, ready for JSON.

        Parameters
        ----------
        programs
            Whether to describe the models on it exactly, so that :meth:`from_record` can make the
            same core. Else there is only what tells them from others.

        Returns
        -------
        dict
            ``parameters`` and ``models``, which results depend on, and ``pipeline``, on which
            they do not.
        """
        record = {"parameters": _record(self.params), "pipeline": _record(self.pipeline)}
        models = self.params.models
        if models:
            record["models"] = {
                "on_core": Placement.of(models).value,
                "digest": f"{models.digest:#010x}",
                "inputs": [*models.inputs],
                "inputs_of_f": models.inputs_of_f,
                "inputs_of_h": models.inputs_of_h,
            }
            if programs:
                record["models"] |= {"programs": models.record()}
        return record

    @property
    def redraws(self) -> bool:
        """Whether the filter on it draws new sigma points after every predict."""
        return self.params.additive_q > 0 if self.redraw is None else self.redraw

    @property
    def title(self) -> str:
        """Name for people: problem or sizes, and what is not as usual."""
        return self.title_without()

    def title_without(self, *labels: str) -> str:
        """Name for people of cores that differ in these parameters only."""
        said = [] if self.problem is None else [self.problem]
        for label, value in self.values().items():
            entry = PARAMETERS[label]
            unusual = entry.meaning.always or value != entry.default
            known = self.problem is not None and entry.meaning.problem
            if unusual and not known and label not in labels:
                said.append(entry.said(value))
        return ", ".join(said)

    @property
    def stem(self) -> str:
        """Name for files."""
        return re.sub(r"[^\w.]+", "-", self.title).lower()

    @property
    def description(self) -> str:
        """All parameters, for people."""
        return ", ".join(PARAMETERS[label].said(value) for label, value in self.values().items())


def _record(block: UkfParams | Pipeline) -> dict[str, Any]:
    return {
        entry.name: entry.record(getattr(block, entry.name))
        for entry in parameters_of(type(block)).values()
    }


def _from_record(block: type[Any], record: Mapping[str, Any]) -> dict[str, Any]:
    return {
        entry.name: entry.from_record(record[entry.name]) for entry in parameters_of(block).values()
    }
