"""Graphs: what is one node, what is left out, and what stays as it was written."""

import numpy as np
import pytest

from support.tracing import graph_of, of_pair
from ukf_sw.tracing.builder import Builder
from ukf_sw.tracing.graph import Graph, Input, Node
from ukf_sw.tracing.listing import listing
from ukf_sw.tracing.operations import COMMUTATIVE, CONDITIONS, FUNCTIONS, LOGICAL, Operation

X = Input("x", (0,), per_point=True)
Y = Input("x", (1,), per_point=True)
U = Input("u")
ADD, MULTIPLY = Operation.ADD, Operation.MULTIPLY


def counts(function, rows=1):
    """Operations by name."""
    graph = graph_of(of_pair(function), rows)
    return {operation.label: count for operation, count in graph.counts().items()}


# Operations.


@pytest.mark.parametrize("operation", [each for each in Operation if each.arity])
def test_operations_take_as_many_arguments_as_they_say(operation):
    given = [np.array([0.25, 0.5])] * operation.arity
    if operation in LOGICAL | {Operation.WHERE}:
        given[0] = given[0] > 0.3
    result = operation.function(*given)
    assert (result.dtype == bool) == operation.is_condition
    assert operation is Operation.WHERE or operation.function is getattr(np, operation.label)


def test_operations_of_no_arguments_compute_nothing():
    for operation in (Operation.INPUT, Operation.CONSTANT):
        with pytest.raises(TypeError, match="inputs and constants have no function"):
            operation.function()


def test_kinds_of_operations_are_told_apart():
    assert LOGICAL < CONDITIONS
    assert not FUNCTIONS & CONDITIONS
    for operation in COMMUTATIVE:
        a, b = np.array([0.1, -0.0, 3.0]), np.array([0.2, 0.0, np.inf])
        if operation in LOGICAL:
            a, b = a > 0.0, b > 0.1
        assert operation.function(a, b).tobytes() == operation.function(b, a).tobytes()


# Equal subexpressions.


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda x, y: np.sin(x[0]) + np.sin(x[0]), {"add": 1, "sin": 1}),
        (lambda x, y: (x[0] + y[0]) * (y[0] + x[0]), {"add": 1, "multiply": 1}),
        (lambda x, y: (x[0] - y[0]) * (y[0] - x[0]), {"subtract": 2, "multiply": 1}),
        (lambda x, y: x[0] * x[1] * x[2] + x[0] * (x[1] * x[2]), {"add": 1, "multiply": 4}),
        (lambda x, y: x[0] ** 2 + x[0] * x[0] + np.square(x[0]), {"add": 2, "multiply": 1}),
        (lambda x, y: x[0] ** 4 + x[0] ** 2, {"add": 1, "multiply": 2}),
        (lambda x, y: x[0] ** 8, {"multiply": 3}),
        (lambda x, y: x[0] ** 7, {"multiply": 4}),
        (lambda x, y: x[0] ** 65, {"power": 1}),
        (lambda x, y: x[0] ** 0.5 + np.sqrt(x[0]), {"add": 1, "sqrt": 1}),
        (lambda x, y: x[0] / 3.0, {"divide": 1}),
        (lambda x, y: np.linalg.norm(x), {"add": 2, "multiply": 3, "sqrt": 1}),
        (lambda x, y: np.where(x[0] > 0, x[0], y[0]), {"greater": 1, "where": 1}),
        (lambda x, y: np.clip(x[0], -1, 1), {"minimum": 1, "maximum": 1}),
        (lambda x, y: np.eye(3)[0] @ x, {"add": 2, "multiply": 2}),
    ],
)
def test_operations_are_counted_once(function, expected):
    assert counts(function) == expected


def test_known_models_have_as_many_operations_as_by_hand():
    def rotate(x, y):
        c, s = np.cos(x[0]), np.sin(x[0])
        return [c * x[1] - s * x[2], s * x[1] + c * x[2]]

    assert counts(rotate, 2) == {"add": 1, "subtract": 1, "multiply": 4, "sin": 1, "cos": 1}

    def quaternion(x, y):
        return [x[0] * y[0] - x[1] * y[1] - x[2] * y[2], x[0] * y[1] + x[1] * y[0]]

    assert counts(quaternion, 2) == {"add": 1, "subtract": 2, "multiply": 5}


def test_what_leads_to_no_result_is_left_out():
    assert counts(lambda x, y: [np.exp(x[0]), x[1] + 1.0][1]) == {"add": 1}


# What stays, and what may go.


def unchanged(expression, at):
    """What one expression in x gives at some points: as traced, and by NumPy."""
    graph = graph_of(lambda x, w, u: expression(x[:1]))
    found = [graph.evaluate({"x": np.array([value]), "u": 0.5}) for value in at]
    with np.errstate(all="ignore"):
        expected = [expression(np.array([value])) for value in at]
    return graph, np.array(found), np.array(expected, dtype=float)


SPECIAL = (0.0, -0.0, 1.0, -1.5, np.inf, -np.inf, np.nan, 5e-324, 1e308)


@pytest.mark.parametrize(
    ("expression", "operations"),
    [
        (lambda x: x + 0.0, 1),
        (lambda x: 0.0 + x, 1),
        (lambda x: x - 0.0, 0),
        (lambda x: x + -0.0, 0),
        (lambda x: -0.0 + x, 0),
        (lambda x: x - -0.0, 1),
        (lambda x: 0.0 - x, 1),
        (lambda x: x * 0.0, 1),
        (lambda x: x * 1.0, 0),
        (lambda x: 1 * x, 0),
        (lambda x: x / 1.0, 0),
        (lambda x: 1.0 / x, 1),
        (lambda x: x * -1.0, 1),
        (lambda x: x * 2.0 * 3.0, 2),
        (lambda x: x + 1.0 + 2.0, 2),
        (lambda x: 2.0 * 3.0 * x, 1),
        (lambda x: np.negative(-x), 0),
        (lambda x: x - x, 1),
        (lambda x: (x - 1.0) + 1.0, 2),
        (lambda x: x / 3.0, 1),
        (lambda x: x == x, 2),
        (lambda x: ~~(x > 0.0), 2),
        (lambda x: (x > 0.0) & True, 2),
        (lambda x: (x > 0.0) | (x > 0.0), 2),
        (lambda x: np.where(x > 0.0, 1.0, 1.0) * x, 0),
        (lambda x: np.where(True, x, -x), 0),
        (lambda x: np.where(x > 0.0, True, False), 2),
    ],
)
def test_bits_are_those_of_numpy(expression, operations):
    """A condition that is a row is made a number, which is one operation more."""
    graph, found, expected = unchanged(expression, SPECIAL)
    assert sum(graph.counts().values()) == operations
    nan = np.isnan(expected)
    assert (np.isnan(found) == nan).all()
    assert found[~nan].tobytes() == expected[~nan].tobytes()


def test_the_order_of_a_sum_is_that_of_the_model():
    x = np.array([1e16, 1.0, -1e16])
    for order, expected in (((0, 1, 2), 0.0), ((0, 2, 1), 1.0)):
        graph = graph_of(lambda x, w, u, o=order: x[o[0]] + x[o[1]] + x[o[2]].reshape(1))
        assert graph.evaluate({"x": x}) == expected


def test_constants_are_computed_while_tracing():
    graph = graph_of(lambda x, w, u: x[:1] * (np.sin(np.array([2.0])) * np.zeros(1) + 3.0))
    assert graph.constants == (3.0,)
    assert graph.counts() == {MULTIPLY: 1}


def test_constants_are_told_apart_by_their_bits():
    graph = graph_of(lambda x, w, u: [x[0] * 0.0, x[0] * -0.0], 2)
    assert [value.hex() for value in graph.constants] == ["0x0.0p+0", "-0x0.0p+0"]


# Numbers and conditions.


def test_conditions_become_numbers_where_numbers_are_wanted():
    graph = graph_of(lambda x, w, u: [(x[0] > 0.0) * x[1], x[0] > 0.0], 2)
    assert graph.counts() == {MULTIPLY: 1, Operation.GREATER: 1, Operation.WHERE: 1}


def test_numbers_become_conditions_where_conditions_are_wanted():
    graph = graph_of(lambda x, w, u: np.where(np.logical_and(x[0], x[1] > 0.0), x[:1], 0.0))
    assert graph.counts()[Operation.NOT_EQUAL] == 1
    assert graph.evaluate({"x": np.array([2.0, 1.0])}) == 2.0
    assert graph.evaluate({"x": np.array([0.0, 1.0])}) == 0.0


# Once, or at every sigma point.


def test_operations_of_inputs_alone_are_done_once():
    def f(x, w, u):
        half = u / 2.0
        turn = np.sin(half) * 3.0
        return [x[0] * turn, half, w[0] + 1.0]

    graph = graph_of(f, 3)
    once = graph.counts(per_point=False)
    assert once == {MULTIPLY: 1, Operation.DIVIDE: 1, Operation.SIN: 1}
    assert graph.counts(per_point=True) == {ADD: 1, MULTIPLY: 1}
    assert sum(graph.counts().values()) == 5
    assert [graph.per_point[row] for row in graph.outputs] == [True, False, True]


def test_results_that_are_the_same_at_every_point_have_its_shape():
    graph = graph_of(lambda x, w, u: [u, 2.0, x[0]], 3)
    x = np.array([[1.0, 2.0, 3.0]])
    found = graph.evaluate({"x": x, "u": 0.5})
    np.testing.assert_array_equal(found, [[0.5] * 3, [2.0] * 3, x[0]])
    constant = graph_of(lambda x, w, u: np.ones(2), 2)
    assert constant.inputs == ()
    np.testing.assert_array_equal(constant.evaluate({"x": x}), np.ones((2, 3)))
    assert constant.evaluate({}).shape == (2,)


def test_depth_is_the_longest_chain():
    graph = graph_of(lambda x, w, u: [x[0], np.sin(x[0] + 1.0) * 2.0, -x[1]], 3)
    assert graph.depth == 3
    assert [graph.levels[row] for row in graph.outputs] == [0, 3, 1]


def test_functions_are_listed():
    graph = graph_of(lambda x, w, u: [np.sin(x[0]) / x[1], np.sqrt(x[0]), x[0] * x[1]], 3)
    assert graph.functions == (Operation.DIVIDE, Operation.SQRT, Operation.SIN)


# Graphs by themselves.


def test_graphs_are_equal_node_for_node():
    def f(x, w, u):
        return np.array([np.hypot(x[0], w[1]), u * x[1] + 2.0])

    first, again = graph_of(f, 2), graph_of(f, 2)
    assert first == again
    assert hash(first) == hash(again)
    assert first != graph_of(lambda x, w, u: np.array([np.hypot(x[0], w[1]), u * x[1] - 2.0]), 2)
    assert Node(Operation.CONSTANT, value=0.0) != Node(Operation.CONSTANT, value=-0.0)
    assert Node(Operation.CONSTANT, value=1.0) != Node(Operation.CONSTANT, value=True)
    assert Node(Operation.CONSTANT, value=1.0) != 1.0
    nan = float("nan")
    assert Node(Operation.CONSTANT, value=nan) == Node(Operation.CONSTANT, value=-nan)


def test_nodes_cannot_change():
    node = Node(Operation.INPUT, source=X)
    with pytest.raises(AttributeError):
        node.value = 1.0


@pytest.mark.parametrize(
    ("nodes", "outputs", "message"),
    [
        ([Node(ADD, (0,))], [0], "node 0 must have 2 arguments, not 1"),
        ([Node(ADD, (0, 0))], [0], r"node 0 must come after its arguments, not before \(0, 0\)"),
        (
            [Node(Operation.INPUT, source=X), Node(ADD, (0, 2)), Node(Operation.INPUT, source=Y)],
            [1], r"node 1 must come after its arguments, not before \(0, 2\)",
        ),
        ([Node(Operation.INPUT, source=X)], [1], "outputs must be numbers of nodes, not 1"),
    ],
)  # fmt: skip
def test_graphs_check_themselves(nodes, outputs, message):
    with pytest.raises(ValueError, match=message):
        Graph(tuple(nodes), tuple(outputs))


def test_builder_gives_the_same_number_for_the_same():
    builder = Builder()
    x, y = builder.input(X), builder.input(Y)
    assert builder.input(X) == x
    assert builder.apply(ADD, x, y) == builder.apply(ADD, y, x)
    assert builder.node(builder.apply(ADD, y, x)).arguments == (x, y)
    two = builder.constant(2.0)
    assert builder.apply(MULTIPLY, two, builder.constant(3)) == builder.constant(6.0)
    assert builder.constant(np.float64(2.0)) == two
    assert builder.graph([y]).nodes == (Node(Operation.INPUT, source=Y),)


def test_inputs_know_where_they_are():
    source = Input("u", ("gain", 1))
    assert source.label == "u['gain'][1]"
    assert source.of({"u": {"gain": [1.0, 2.0]}}) == 2.0
    assert U.label == "u"
    with pytest.raises(KeyError):
        U.of({"x": 1.0})


# Listings.


def test_listings_can_be_executed():
    """They are Python, so that what they say can be compared with the graph."""

    def f(x, w, u):
        shared = np.sin(x[0] - (w[0] - u))
        gain = u * 2.0
        z = np.where((x[1] > 0.0) & ~(x[2] < -0.5), shared / (w[1] / gain), -((-x[1] * 3.0) ** 3))
        return [z - (shared - gain), ((x[0] * x[1]) ** -1.5) ** x[2], np.maximum(x[2], -2.0) * gain]

    graph = graph_of(f, 3)
    text = listing(graph, ["a", "b", "c"])
    assert "  # once" in text
    assert [line.split(" = ")[0] for line in text.splitlines()][-3:] == ["a", "b", "c"]
    names = {
        operation.label: operation.function
        for operation in Operation
        if operation.arity and not operation.symbol
    }
    for point in np.random.default_rng(3).uniform(0.1, 1.0, (10, 6)):
        found = {**names, "x": point[:3], "w": point[3:], "u": 0.75}
        exec(text, found)
        expected = graph.evaluate({"x": point[:3], "w": point[3:], "u": 0.75})
        assert [found[name] for name in "abc"] == expected.tolist()


def test_listings_call_inputs_as_they_are_told():
    graph = graph_of(lambda x, w, u: [x[0] * u, x[1] - 1.0], 2)
    text = listing(graph, ["a", "b"], {"x[0]": "speed", "u": "interval"})
    assert text == "a = speed * interval\nb = x[1] - 1.0"
