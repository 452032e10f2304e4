"""The cores of a sweep."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from ukf_sw.spec.float_format import BINARY32, FloatFormat
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams

__all__ = ["Point", "grid"]


@dataclass(frozen=True, kw_only=True)
class Point:
    """A core of a sweep, which need not be legal: :attr:`params` says so.

    Parameters
    ----------
    configuration
        Name of its configuration, or None.
    base
        Sizes, kinds of noise and W0.
    pes, form, format, pipeline
        What a sweep varies.
    """

    configuration: str | None = None
    base: UkfParams
    pes: int = 1
    form: Form = Form.SQUARE_ROOT
    format: FloatFormat = BINARY32
    pipeline: Pipeline = field(default_factory=Pipeline)

    @property
    def params(self) -> UkfParams:
        """What the core computes.

        Raises
        ------
        ValueError
            If there is no such core, with more processing elements than columns for instance.
        """
        return replace(self.base, pes=self.pes, form=self.form, format=self.format)

    @property
    def title(self) -> str:
        """Name for people."""
        b = self.base
        name = self.configuration or f"n = {b.n}, m = {b.m}, q = {b.q}, r = {b.r}"
        stages = "/".join(str(stage) for stage in _stages(self.pipeline).values())
        return (
            f"{name}, {self.pes} PE{'s' * (self.pes != 1)}, {self.form.value}, "
            f"{self.format.name}, stages {stages}"
        )

    def columns(self) -> dict[str, Any]:
        """What tells this core from others, by name of the column."""
        b = self.base
        return {
            "configuration": self.configuration,
            "n": b.n, "m": b.m, "q": b.q, "r": b.r,
            "process_noise": b.process_noise.value,
            "observation_noise": b.observation_noise.value,
            "W0": float(b.W0), "sigma_points": b.N,
            "pes": self.pes, "form": self.form.value, "format": self.format.name,
            **_stages(self.pipeline),
        }  # fmt: skip


def _stages(pipeline: Pipeline) -> dict[str, int]:
    """Pipeline depths by name of the column."""
    return {
        "multiply_stages": pipeline.multiply,
        "add_stages": pipeline.add,
        "reciprocal_sqrt_stages": pipeline.reciprocal_sqrt,
    }


def grid(
    bases: Sequence[tuple[str | None, UkfParams]],
    *,
    pes: Sequence[int] = (1,),
    forms: Sequence[Form] = (Form.SQUARE_ROOT,),
    formats: Sequence[FloatFormat] = (BINARY32,),
    pipelines: Sequence[Pipeline] = (Pipeline(),),
) -> list[Point]:
    """Make the points of a full grid, without duplicates.

    Parameters
    ----------
    bases
        Name of the configuration, or None, with sizes, kinds of noise and W0.
    pes, forms, formats, pipelines
        What is combined with each.

    Raises
    ------
    ValueError
        If there is nothing of one of them.
    """
    axes = {"bases": bases, "pes": pes, "forms": forms, "formats": formats, "pipelines": pipelines}
    for name, values in axes.items():
        if not values:
            raise ValueError(f"{name} must have at least one entry, not {values!r}")
    points = (
        Point(configuration=name, base=base, pes=number, form=form, format=kind, pipeline=pipeline)
        for (name, base), form, kind, pipeline, number in product(
            bases, forms, formats, pipelines, pes
        )
    )
    return list(dict.fromkeys(points))
