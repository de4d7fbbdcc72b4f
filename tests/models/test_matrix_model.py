"""Linear models by their matrices: constant, with named entries, and varying over time."""

import numpy as np
import pytest

from noiseid_cli.errors import ModelError
from noiseid_cli.filters.ekf import extended_kalman_filter
from noiseid_cli.models import Quantity
from noiseid_cli.models.compile import cache_key, compile_model, model_key
from noiseid_cli.models.describe import describe
from noiseid_cli.models.known_inputs import with_known_inputs
from noiseid_cli.models.matrix_model import MatrixNames, matrix_model
from noiseid_cli.models.noise import NoiseValues
from noiseid_cli.models.recording import Recording

A, B, G = [[0.9, 0.1], [0.0, 0.5]], [[0.0], [2.0]], [[0.0], [1.0]]
C, D = [[1.0, 0.0], [1.0, 1.0]], [[0.0], [0.25]]
CONSTANT = {"A": A, "B": B, "G": G, "C": C, "D": D}


def functions(model, x, u):
    """Rate or next state with its Jacobians, output with its Jacobian."""
    out = [np.empty(model.nx), np.empty((model.nx, model.nx)), np.empty((model.nx, model.nv))]
    y = [np.empty(model.ny), np.empty((model.ny, model.nx))]
    x, u = np.array(x, dtype=float), np.array(u, dtype=float)
    model.drift_jacobian(x, u, model.parameters, *out)
    model.output_jacobian(x, u, model.parameters, *y)
    return [*out, *y]


def test_compiled_functions_are_the_matrices():
    x, u = np.array([3.0, -2.0]), np.array([4.0])
    model = compile_model(matrix_model(CONSTANT))
    f, F, Fv, y, H = functions(model, x, u)
    np.testing.assert_allclose(f, np.array(A) @ x + np.array(B) @ u, rtol=1e-15)
    np.testing.assert_allclose(y, np.array(C) @ x + np.array(D) @ u, rtol=1e-15)
    for ours, matrix in ((F, A), (Fv, G), (H, C)):
        np.testing.assert_array_equal(ours, matrix)
    assert (model.states, model.inputs, model.noises, model.outputs) == (("x1", "x2"), ("u1",), ("v1",), ("y1", "y2"))


def test_named_entries_are_parameters_and_the_compiled_equations_agree():
    named = matrix_model(CONSTANT | {"A": [["rho", 0.1], [0.0, 0.5]]}, parameters={"rho": 0.9})
    assert [(p.name, p.value) for p in named.parameters_in_force] == [("rho", 0.9)]
    ours, theirs = (functions(compile_model(m), [3.0, -2.0], [4.0]) for m in (named, matrix_model(CONSTANT)))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15)
    assert describe(named).equations[0].text == "x1[k+1] = rho·x1 + 0.1·x2"
    with pytest.raises(ModelError, match="rho stands in a matrix and has no value"):
        matrix_model({"A": [["rho"]], "C": [[1.0]]})
    with pytest.raises(ModelError, match="parameter tau is not known"):
        matrix_model(CONSTANT, parameters={"tau": 1.0})


def test_defaults_are_one_noise_a_state_and_no_input():
    model = compile_model(matrix_model({"A": A, "C": C}))
    assert (model.nu, model.noises) == (0, ("v1", "v2"))
    np.testing.assert_array_equal(functions(model, [1.0, 1.0], [])[2], np.eye(2))


def test_names_units_and_discretisation():
    names = MatrixNames(states=(Quantity("p", "m"), Quantity("w", "m/s")), outputs=(Quantity("a"), Quantity("b")))
    model = matrix_model(CONSTANT, names, "exact", 0.25)
    assert (model.discretisation, model.sample_time, type(model).discretisation) == ("exact", 0.25, "exact")
    assert compile_model(model).units["w"] == "m/s"
    assert [e.text for e in describe(model).equations][:2] == ["d p/dt = 0.9·p + 0.1·w", "d w/dt = 2·u1 + v1 + 0.5·w"]
    assert describe(matrix_model({"A": [[1e-7]], "C": [[1]]})).equations[0].latex.endswith(r"1 \cdot 10^{-7} x_{1}")


VARYING = np.array([[[1.0, 0.5 * k], [0.0, 0.8 + 0.01 * k]] for k in range(20)])
SENSED = np.array([[[1.0, np.sin(k)]] for k in range(20)])


def test_varying_matrices_are_filtered_as_in_the_textbook():
    model = matrix_model({"A": VARYING, "C": SENSED, "B": [[1.0], [0.0]]})
    assert set(model.known_inputs) == {"A_1_2", "A_2_2", "C_1_2"}
    assert [q.name for q in model.driven_inputs] == ["u1"]
    rng = np.random.default_rng(3)
    given, y = rng.normal(size=(20, 1)), rng.normal(size=(20, 1))
    recording = Recording("test", np.ones(19), with_known_inputs(model, given, "test"), y)
    Q, R, P0 = np.diag([0.3, 0.1]), np.array([[0.2]]), np.diag([1.0, 2.0])
    noise = NoiseValues(Q, R, np.zeros((1, 2)), P0)
    filtered = extended_kalman_filter(compile_model(model), recording, noise)
    m, P, loglik = np.zeros(2), P0, 0.0
    for k in range(20):
        H = SENSED[k]
        S = (H @ P @ H.T + R)[0, 0]
        e = (y[k] - H @ m)[0]
        loglik -= 0.5 * (np.log(2 * np.pi * S) + e * e / S)
        K = (P @ H.T / S)[:, 0]
        m, P = m + K * e, P - np.outer(K, K) * S
        np.testing.assert_allclose(filtered.m_filt[k], m, rtol=0, atol=1e-10)
        m, P = VARYING[k] @ m + np.array([given[k, 0], 0.0]), VARYING[k] @ P @ VARYING[k].T + Q
    assert filtered.loglik == pytest.approx(loglik, rel=1e-12)


def test_known_inputs_keep_the_order_of_the_model_and_their_length_is_checked():
    model = matrix_model({"A": VARYING, "C": [[1.0, 0.0]], "B": [[1.0], [0.0]]})
    u = with_known_inputs(model, np.arange(20.0)[:, None], "test 'a'")
    order = [q.name for q in model.inputs]
    np.testing.assert_array_equal(u[:, order.index("u1")], np.arange(20.0))
    np.testing.assert_array_equal(u[:, order.index("A_2_2")], VARYING[:, 1, 1])
    with pytest.raises(ModelError, match="test 'a' has 5 samples, but A_1_2, which comes with the model, has 20"):
        with_known_inputs(model, np.zeros((5, 1)), "test 'a'")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"C": [[1.0]]}, "C is 1 x 1, expected 1 x 2"),
        ({"A": [[1.0, 2.0]]}, "A is 1 x 2, expected 1 x 1"),
        ({"A": [[1.0, 2.0], [3.0]]}, "rows of A differ in length"),
        ({"A": np.full((2, 2), np.nan)}, "A has an entry that is not a finite number"),
        ({"A": np.ones(3)}, r"A has the shape \(3,\)"),
        ({"A": VARYING, "C": np.ones((7, 2, 2))}, "differ in length: A 20, C 7 samples"),
        ({"G": [[1.0, 0.0], [0.0, 0.0]]}, "column 2 of G is zero: the noise v2 drives no state"),
        ({"G": np.zeros((3, 2, 1))}, "column 1 of G is zero: the noise v1 drives no state"),
    ],
)
def test_what_does_not_fit_is_told(change, message):
    with pytest.raises(ModelError, match=message):
        matrix_model(CONSTANT | change)


def test_a_noise_that_drives_a_state_at_some_times_is_one():
    assert len(matrix_model({"A": A, "C": C, "G": np.eye(2)[:, :1] * np.arange(5.0)[:, None, None]}).noises) == 1
    assert len(matrix_model({"A": A, "C": C, "G": [["g"], [0]]}, parameters={"g": 0.0}).noises) == 1


def test_key_of_constant_matrices_follows_numbers_and_names():
    """Two models have one key if and only if their equations are the same ones."""
    names = MatrixNames(states=(Quantity("p", "m"), Quantity("w")))
    models = [
        matrix_model(CONSTANT | change) for change in ({}, {"A": np.array(A)}, {"A": np.eye(2)}, {"C": np.eye(2)})
    ]
    models += [matrix_model(CONSTANT, names), matrix_model(CONSTANT | {"D": [[0], [0.25]]}, sample_time=0.5)]
    models.append(matrix_model(CONSTANT | {"A": [["a", 0.1], [0, 0.5]]}, parameters={"a": 0.9}))
    keys, equations = [model_key(m) for m in models], [cache_key(m.equations()) for m in models]
    for i in range(len(models)):
        assert [k == keys[i] for k in keys] == [e == equations[i] for e in equations], i
    assert len(set(keys)) == 5


def test_missing_matrices_and_names_of_another_number():
    with pytest.raises(ModelError, match="the matrix C is missing"):
        matrix_model({"A": A})
    with pytest.raises(ModelError, match="1 states are named, but the matrices have 2"):
        matrix_model(CONSTANT, MatrixNames(states=(Quantity("p"),)))
