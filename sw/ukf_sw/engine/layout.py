"""Where every vector lives in the memories of the processing elements.

Every matrix row is a vector: element ``k`` lies in lane ``k mod P``, beat ``k div P``, and the
beats of a vector are consecutive addresses, the same in every lane. The rows of sigma points and
of residuals share one set of columns::

    sigma points 0 to N - 1 | right-hand side | additive r noise | additive q noise

so that the residual matrix ``E`` of the design, with the innovation as one more column, can be
formed in place, column by column. With W0 = 0 sigma point 0 has no weight, and the right-hand side
takes its column::

    right-hand side | sigma points 1 to N - 1 | additive r noise | additive q noise
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ukf_sw.engine.constants import noise_coefficients, state_coefficients, unit, weights
from ukf_sw.spec.parameters import Form, UkfParams

__all__ = [
    "BANK_FACTOR", "BANK_NONE", "BANK_STATE", "TEMPORARY", "Layout", "Vector", "Word", "is_banked",
]  # fmt: skip

BANK_NONE, BANK_STATE, BANK_FACTOR, TEMPORARY = range(4)

#: Address of a word in every lane, and the bank bit that completes it. The temporaries of a model's
#: program have numbers instead of addresses, until the program has been scheduled.
Word = tuple[int, int]


def is_banked(word: Word) -> bool:
    """Whether a word has two copies, of which programs read one and write the other."""
    return word[1] in (BANK_STATE, BANK_FACTOR)


@dataclass(frozen=True)
class Vector:
    """A run of columns in the memories.

    Parameters
    ----------
    name
        For messages.
    address
        Address of the first beat, in every lane.
    first, beats
        The beats that exist. Columns below or above are not stored.
    pes
        Number of lanes.
    columns
        Columns that it has, from the first up to the last, exclusive.
    bank
        Which bank bit completes its addresses.
    broadcast
        Whether it is one number, the same in every lane.
    """

    name: str
    address: int
    first: int
    beats: int
    pes: int
    columns: tuple[int, int]
    bank: int = BANK_NONE
    broadcast: bool = False

    def word(self, beat: int) -> Word:
        """Address of a beat.

        Raises
        ------
        IndexError
            If the vector has no such beat.
        """
        if not self.first <= beat < self.first + self.beats:
            raise IndexError(f"{self.name} has no beat {beat!r}")
        return self.address + beat - self.first, self.bank

    def element(self, column: int) -> tuple[Word, int]:
        """Address and lane of an element."""
        return self.word(column // self.pes), column % self.pes


class Layout:
    """The memories of the processing elements of one core.

    The current and the next copy of the state and of its factor differ in the top address bit
    (:attr:`bank_offset`), so a step commits them by turning a bank bit.

    Parameters
    ----------
    params
        What the core computes.
    temporaries
        Words for temporaries of models, beyond those that other vectors lend them.

    Attributes
    ----------
    points
        Columns of the sigma points that have a weight: the first one, and one after the last one.
        Sigma point k is column k.
    rhs, columns
        Column of the right-hand side, number of columns.
    noise_r, noise_q
        Columns of additive noise, as those of the points.
    vectors
        All vectors, in the order of their addresses.
    address_width
        Width of an address within a lane.
    """

    def __init__(self, params: UkfParams, temporaries: int = 0) -> None:
        self.params = p = params
        self._temporaries = temporaries
        self.points = (p.points.start, p.points.stop)
        self.rhs = 0 if p.points.start else p.N
        before_noise = max(p.N, self.rhs + 1)
        self.noise_r = (before_noise, before_noise + p.columns_of_r)
        self.noise_q = (self.noise_r[1], self.noise_r[1] + p.additive_q)
        self.columns = self.noise_q[1]
        #: Column of the right-hand side in a row of the joint covariance.
        self.joint_rhs = p.largest_sensor + p.n
        #: Column of the right-hand side in the rows that an update eliminates.
        self.elimination_rhs = self.rhs if p.form is Form.SQUARE_ROOT else self.joint_rhs
        self.address_width = 1
        while not self._place():
            self.address_width += 1

    def _place(self) -> bool:
        """Give every vector a place; False if the memories are too small for them."""
        p = self.params
        full, observation, points = (0, self.columns), (0, self.noise_r[1]), (0, p.N)
        self._constants: list[tuple[Vector, NDArray[np.float64]]] = []
        self.vectors: list[Vector] = []
        self._next = 0
        self._banked = 0

        # Banked vectors come first: they start both halves of the memory.
        #: State estimate, one element per state.
        self.x = self._vector("x", (0, p.n), BANK_STATE)
        #: Rows of the factor of its covariance.
        self.L = self._vectors("L", p.n, (0, p.n), BANK_FACTOR)
        self._banked = self._next
        #: Sigma points: of the state, of the noises, of the observation. The columns beside them
        #: hold the factors of additive noise, and in Z the measurement as right-hand side.
        self.X = self._vectors("X", p.n, full)
        self.W = self._vectors("W", p.augmented_q, points)
        self.V = self._vectors("V", p.augmented_r, points)
        self.Z = self._vectors("Z", p.m, observation)
        #: Covariance, and the factors of augmented noise.
        self.P = self._vectors("P", p.n, (0, p.n))
        self.LQ = self._vectors("LQ", p.augmented_q, (0, p.augmented_q))
        self.LR = self._vectors("LR", p.augmented_r, (0, p.augmented_r))
        #: Working copy of the factor, in units of sqrt(W1).
        self.F = self._vectors("F", p.n, (0, p.n))
        #: Residuals of the prediction, which an update leaves as they are.
        self.Ex = self._vectors("Ex", p.n, full)
        #: Residuals of the observations of a sensor; one with fewer has the last rows, so that its
        #: rows are next to those of the state in the elimination, as are its columns below.
        self.Ez = self._vectors("Ez", p.largest_sensor, observation)
        joint = (0, self.joint_rhs + 1)
        covariance = p.form is Form.COVARIANCE
        #: Upper rows of the joint covariance of observation and state; those of the state are
        #: the prediction's and an update leaves them as they are.
        self.Az = self._vectors("Az", p.largest_sensor if covariance else 0, joint)
        self.Ax = self._vectors("Ax", p.n if covariance else 0, joint)
        #: State rows while they are eliminated.
        self.G = self._vectors("G", p.n, joint if covariance else full)
        #: 1/sqrt of every pivot, the same in every lane.
        self.roots = [
            self._vector(f"root[{j}]", (0, p.pes), broadcast=True)
            for j in range(p.largest_sensor + p.n)
        ]

        root = unit(p)
        before_noise = self.noise_r[0]
        scale = np.full(self.columns, 1.0 / root)
        scale[:before_noise] = 1.0
        if p.W0:
            scale[0] = np.sqrt(p.W0) / root
        ones = np.zeros(self.columns)
        ones[:before_noise] = 1.0
        self.weights = self._constant("weights", points, weights(p))
        self.ones = self._constant("ones", full, ones)
        #: What turns residuals into units of sqrt(W1).
        self.scale = self._constant("scale", full, scale)
        self.one = self._broadcast("one", 1.0)
        self.root_weight = self._broadcast("root_weight", root)
        self.inverse_root_weight = self._broadcast("inverse_root_weight", 1.0 / root)
        self.weight = self._broadcast("weight", root**2)
        self.inverse_weight = self._broadcast("inverse_weight", root**-2)
        self.state_sigma = [
            self._constant(f"state_sigma[{j}]", (0, p.n + 2), row)
            for j, row in enumerate(state_coefficients(p))
        ]
        self.noise_sigma = [
            self._constant(f"noise_sigma[{j}]", points, row)
            for j, row in enumerate(noise_coefficients(p))
        ]
        self._place_models()
        return self._next <= self.depth

    def _place_models(self) -> None:
        """Give what the models of the core need a place."""
        models, pes = self.params.models, self.params.pes
        scalars = dict.fromkeys(value.hex() for program in models for value in program.scalars)
        words = dict.fromkeys(value.hex() for program in models for value in program.words)
        #: Inputs, one after the other.
        self.U = self._vectors("U", int(bool(models.inputs)), (0, len(models.inputs)))
        #: Constants that become scalars, one after the other, and the column of each, by their
        #: value in hexadecimal, which has the sign of zero.
        self.model_scalars: Vector | None = None
        self.scalar_columns = {value: column for column, value in enumerate(scalars)}
        if scalars:
            values = np.array([*map(float.fromhex, scalars)])
            self.model_scalars = self._constant("model_scalars", (0, len(values)), values)
        #: Constants that are words, by their value alike.
        self.model_words = {
            value: self._broadcast(f"model_word[{k}]", float.fromhex(value))
            for k, value in enumerate(words)
        }
        self.temporaries = self._vectors("temporary", self._temporaries, (0, pes))

    def _vector(
        self,
        name: str,
        columns: tuple[int, int],
        bank: int = BANK_NONE,
        *,
        broadcast: bool = False,
    ) -> Vector:
        """Place a vector that has the columns from the first up to the last, exclusive."""
        pes = self.params.pes
        first = columns[0] // pes
        beats = -(-columns[1] // pes) - first
        start, stop = self.bank_offset, self.bank_offset + self._banked
        if self._next < stop and self._next + beats > start:  # the other bank is in the way
            self._next = stop
        vector = Vector(name, self._next, first, beats, pes, columns, bank, broadcast)
        self.vectors.append(vector)
        self._next += beats
        return vector

    def _vectors(
        self, name: str, rows: int, columns: tuple[int, int], bank: int = BANK_NONE
    ) -> list[Vector]:
        return [self._vector(f"{name}[{i}]", columns, bank) for i in range(rows)]

    def _constant(
        self,
        name: str,
        columns: tuple[int, int],
        values: NDArray[np.float64],
        *,
        broadcast: bool = False,
    ) -> Vector:
        """Place a vector of fixed contents; lanes beside its columns hold zero."""
        vector = self._vector(name, columns, broadcast=broadcast)
        row = np.zeros(vector.beats * self.params.pes)
        start = columns[0] - vector.first * self.params.pes
        row[start : start + len(values)] = values
        self._constants.append((vector, row))
        return vector

    def _broadcast(self, name: str, value: float) -> Vector:
        """Place a word that holds one number in every lane."""
        values = np.full(self.params.pes, value)
        return self._constant(name, (0, self.params.pes), values, broadcast=True)

    @cached_property
    def _owners(self) -> dict[Word, tuple[Vector, int]]:
        """Vector and beat of every word."""
        return {
            vector.word(beat): (vector, beat)
            for vector in self.vectors
            for beat in range(vector.first, vector.first + vector.beats)
        }

    def find(self, word: Word) -> tuple[Vector, int]:
        """Find the vector that a word belongs to, and which beat of it the word is.

        Raises
        ------
        KeyError
            If it belongs to none.
        """
        return self._owners[word]

    @property
    def spans(self) -> dict[str, tuple[int, int]]:
        """Columns of the rows, from the first up to the last, exclusive, by name for people."""
        spans = {
            "sigma points": self.points,
            "right-hand side": (self.rhs, self.rhs + 1),
            "additive observation noise": self.noise_r,
            "additive process noise": self.noise_q,
        }
        return {name: (start, stop) for name, (start, stop) in spans.items() if stop > start}

    @property
    def bank_offset(self) -> int:
        """Distance of the two banks: the top address bit."""
        return 1 << (self.address_width - 1)

    @property
    def depth(self) -> int:
        """Words in each lane."""
        return 1 << self.address_width

    @property
    def used(self) -> int:
        """Words in each lane up to the last one in use."""
        return max(self._next, self.bank_offset + self._banked)

    def initial_words(self) -> NDArray[np.uint64]:
        """Contents of the memories before the first step, shape (pes, depth): the constants."""
        words = np.zeros((self.params.pes, self.depth), dtype=np.uint64)
        for vector, row in self._constants:
            beats = self.params.format.encode(row).reshape(vector.beats, self.params.pes)
            words[:, vector.address : vector.address + vector.beats] = beats.T
        return words

    def buffer_vector(self, symbol: str, row: int) -> tuple[Vector, int]:
        """Find the vector that holds a row of a buffer region, and the column of its element 0."""
        p = self.params
        if symbol == "z":
            return self.Z[row], self.rhs
        if symbol == "x":
            return self.x, 0
        if symbol == "LQ" and p.additive_q:
            return self.X[row], self.noise_q[0]
        if symbol == "LR" and p.additive_r:
            return self.Z[row], self.noise_r[0]
        return getattr(self, symbol)[row], 0

    def buffer_location(
        self, symbol: str, row: int, column: int, *, state_bank: int = 0, factor_bank: int = 0
    ) -> tuple[int, int]:
        """Find the lane and the address of an element of a buffer region.

        Parameters
        ----------
        symbol, row, column
            Region of :class:`ukf_sw.spec.memory_map.MemoryMap` and element.
        state_bank, factor_bank
            Which copies of x and of L are the current ones.
        """
        vector, offset = self.buffer_vector(symbol, row)
        (address, bank), lane = vector.element(offset + column)
        turned = {BANK_NONE: 0, BANK_STATE: state_bank, BANK_FACTOR: factor_bank}[bank]
        return lane, address + turned * self.bank_offset
