"""The matrix exponential and the exact step of linear models, against scipy, Van Loan's limits and a fine step."""

import numpy as np
import pytest
import sympy as sp
from one_step import transition, workspace
from scipy.linalg import block_diag, expm

from noiseid_cli.errors import ModelError
from noiseid_cli.models import Model, Parameter, Quantity
from noiseid_cli.models.compile import compile_model
from noiseid_cli.models.exponential import held_exponential
from noiseid_cli.models.schemes import DENSITY, EXACT, RK4


def exponential(A, dt):
    n = len(A)
    Phi, Psi = np.empty((n, n)), np.empty((n, n))
    held_exponential(np.ascontiguousarray(A, dtype=float), dt, Phi, Psi, np.empty(2 * n * n + n))
    return Phi, Psi


def reference(A, dt):
    """Both blocks of the exponential of [A I; 0 0] dt (Van Loan 1978)."""
    n = len(A)
    E = expm(np.block([[A, np.eye(n)], [np.zeros((n, 2 * n))]]) * dt)
    return E[:n, :n], E[:n, n:]


@pytest.mark.parametrize("size", [1e-9, 1e-2, 1.0, 10.0])
def test_exponential_equals_that_of_scipy(size):
    rng = np.random.default_rng(1)
    for n in (1, 2, 5, 8):
        A = rng.normal(size=(n, n)) * size
        for ours, theirs in zip(exponential(A, 0.7), reference(A, 0.7), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())


def test_exponential_of_known_matrices():
    Phi, Psi = exponential([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], 0.5)
    np.testing.assert_array_equal(Phi, [[1, 0.5, 0.125], [0, 1, 0.5], [0, 0, 1]])
    np.testing.assert_allclose(Psi, [[0.5, 0.125, 0.125 / 6], [0, 0.5, 0.125], [0, 0, 0.5]], rtol=1e-15)
    Phi, Psi = exponential([[-300.0]], 1.0)
    assert Phi[0, 0] == pytest.approx(np.exp(-300.0), rel=1e-12)
    assert Psi[0, 0] == pytest.approx(1.0 / 300.0, rel=1e-14)
    Phi, Psi = exponential([[0.0, 0.0], [0.0, 0.0]], 3.0)
    np.testing.assert_array_equal(Phi, np.eye(2))
    np.testing.assert_array_equal(Psi, 3.0 * np.eye(2))


def test_units_of_the_states_do_not_matter():
    """A stiff oscillator in metres and in nanometres: balancing takes the same steps for both, to the bit."""
    w, z = 3000.0, 0.01
    A = np.array([[0.0, 1.0], [-w * w, -2 * z * w]])
    T = np.diag([2.0**30, 2.0**-7])
    for ours, other in zip(exponential(A, 1e-3), exponential(T @ A @ np.linalg.inv(T), 1e-3), strict=True):
        np.testing.assert_array_equal(T @ ours @ np.linalg.inv(T), other)
    d = w * np.sqrt(1 - z * z)
    peak = np.exp(-z * w * 1e-3) * np.sin(d * 1e-3) / d
    assert exponential(A, 1e-3)[0][0, 1] == pytest.approx(peak, rel=1e-12)


def test_exponential_of_what_is_not_finite_is_not_a_number():
    assert all(np.isnan(M).all() for M in exponential([[np.inf, 0.0], [0.0, 1.0]], 1.0))


class Oscillator(Model):
    """A mass on a spring with a force, a stiffness that an input scales, and a constant push."""

    name = "oscillator"
    states = (Quantity("s", "m"), Quantity("w", "m/s"))
    inputs = (Quantity("force", "N"), Quantity("stiffening", "1"))
    noises = (Quantity("n", "N"),)
    outputs = (Quantity("s", "m"),)
    parameters = (Parameter("k", 40.0, "N/m"), Parameter("c", 0.3, "N s/m"))
    sample_time = 0.1
    discretisation = "exact"

    def terms(self, x, u, p):
        t = super().terms(x, u, p)
        t.spring = p.k * (1 + u.stiffening) * x.s
        return t

    def dynamics(self, x, u, v, p):
        t = self.terms(x, u, p)
        return [x.w, u.force - t.spring - p.c * x.w + 0.2 + (1 + u.stiffening) * v.n]

    def output(self, x, u, p):
        return [x.s**3]


@pytest.fixture(scope="module")
def oscillator():
    return compile_model(Oscillator())


def step(model, x, u, dt, scheme=EXACT, work=None):
    x_next, F, G = np.full(2, np.nan), np.full((2, 2), np.nan), np.full((2, 1), np.nan)
    work = workspace(2, 1) if work is None else work
    x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
    transition(scheme, model.drift_jacobian, x, u, dt, model.parameters, x_next, F, G, work)
    return x_next, F, G


def test_exact_step_is_the_limit_of_many_short_ones(oscillator):
    """Runge-Kutta over 400 parts errs by about (6.3 * 0.5 / 400)^4 / 120 = 3e-11; the exact one by none."""
    x, u, dt, parts = np.array([0.4, -1.0]), np.array([2.0, 0.1]), 0.5, 400
    whole, F, G = step(oscillator, x, u, dt)
    fine, exact, product, gain = x, x, np.eye(2), np.zeros((2, 1))
    for _ in range(parts):
        fine = step(oscillator, fine, u, dt / parts, RK4)[0]
        exact, F_part, G_part = step(oscillator, exact, u, dt / parts)
        product, gain = F_part @ product, F_part @ gain + G_part
    np.testing.assert_allclose(whole, fine, rtol=0, atol=1e-9)
    np.testing.assert_allclose(whole, exact, rtol=0, atol=1e-12)
    np.testing.assert_allclose(F, product, rtol=0, atol=1e-12)
    np.testing.assert_allclose(G, gain, rtol=0, atol=1e-12)


def test_noise_held_over_a_short_interval_is_that_of_van_loan():
    """Many short intervals of held noise with density S add up to Van Loan's covariance of white noise."""
    A, B, S, dt, parts = np.array([[0.0, 1.0], [-40.0, -0.3]]), np.array([[0.0], [1.0]]), 2.0, 0.3, 2000
    E = expm(np.block([[-A, S * B @ B.T], [np.zeros((2, 2)), A.T]]) * dt)
    van_loan = E[2:, 2:].T @ E[:2, 2:]
    Phi, Psi = exponential(A, dt / parts)
    G = Psi @ B / np.sqrt(dt / parts)
    P = np.zeros((2, 2))
    for _ in range(parts):
        P = Phi @ P @ Phi.T + S * G @ G.T
    # Holding errs by (w dt / parts)^2 / 12 = 8e-8 of the whole.
    np.testing.assert_allclose(P, van_loan, rtol=1e-6, atol=1e-7 * np.abs(van_loan).max())


def test_kept_exponential_serves_equal_steps_only(oscillator):
    work = workspace(2, 1)
    cases = [([1.0, 0.0], [0.0, 0.0], 0.1), ([0.0, 2.0], [1.0, 0.0], 0.1), ([0.0, 2.0], [1.0, 0.5], 0.1),
             ([0.0, 2.0], [1.0, 0.5], 0.2), ([1.0, 0.0], [0.0, 0.0], 0.1)]  # fmt: skip
    for x, u, dt in cases:
        for kept, fresh in zip(step(oscillator, x, u, dt, work=work), step(oscillator, x, u, dt), strict=True):
            np.testing.assert_array_equal(kept, fresh)
    before = work[5:9].copy()
    step(oscillator, [5.0, 5.0], [3.0, 0.0], 0.1, work=work)
    np.testing.assert_array_equal(work[5:9], before)
    work[5:9] = 0.0
    assert np.all(step(oscillator, [5.0, 5.0], [3.0, 0.0], 0.1, work=work)[1] == 0.0), "it was computed anew"


@pytest.mark.parametrize("scheme", [EXACT, RK4])
def test_density_divides_the_covariance_by_the_interval(oscillator, scheme):
    for dt in (0.1, 0.04):
        x_next, F, G = step(oscillator, [1.0, 2.0], [0.0, 0.0], dt, scheme)
        with_density = step(oscillator, [1.0, 2.0], [0.0, 0.0], dt, scheme + DENSITY)
        np.testing.assert_array_equal(with_density[0], x_next)
        np.testing.assert_array_equal(with_density[1], F)
        np.testing.assert_allclose(with_density[2] @ with_density[2].T, G @ G.T / dt, rtol=1e-14)


class Pendulum(Oscillator):
    """Not linear: the sine of its angle stands in a term."""

    def terms(self, x, u, p):
        t = Model.terms(self, x, u, p)
        t.spring = p.k * sp.sin(x.s)
        return t


class Parametric(Oscillator):
    """Not linear: the noise gain depends on a state."""

    def dynamics(self, x, u, v, p):
        return [x.w, -p.k * x.s - p.c * x.w + u.force + x.s * v.n]


@pytest.mark.parametrize(
    ("model", "why"),
    [(Pendulum, "slope in s depends on s"), (Parametric, "slope in n depends on s")],
)
def test_exact_is_refused_for_nonlinear_dynamics(model, why):
    with pytest.raises(ModelError, match=f"exact is for linear dynamics only; the rate of w is not linear: its {why}"):
        model().equations()


def test_linear_in_disguise_is_linear():
    class Disguised(Oscillator):
        def dynamics(self, x, u, v, p):
            return [x.w, ((x.s + 1) ** 2 - x.s**2 - 1) / 2 + v.n]

    assert str(sp.expand(Disguised().equations().dynamics[1])) == "n + s"


def test_block_diagonal_parts_do_not_mix():
    A1, A2 = np.array([[0.0, 1.0], [-4.0, 0.0]]), np.array([[-1e4]])
    Phi, _ = exponential(block_diag(A1, A2), 0.1)
    np.testing.assert_array_equal(Phi[:2, 2], 0.0)
    np.testing.assert_array_equal(Phi[2, :2], 0.0)
    np.testing.assert_allclose(Phi[:2, :2], expm(A1 * 0.1), rtol=1e-11)


def test_outputs_that_see_an_input_directly_are_found_and_told():
    from pendulum import Pendulum

    from noiseid_cli.models.linearity import direct_inputs
    from noiseid_cli.pipeline.datasets import _direct_notes

    assert direct_inputs(Pendulum().equations()) == [set(), {"tau"}]
    (note,) = _direct_notes(Pendulum())
    assert note.startswith("a_meas depends directly on tau, which after decimation is the average")
