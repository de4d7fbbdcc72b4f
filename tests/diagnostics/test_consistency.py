"""Consistency: against slow loops, against known distributions, with gaps and several tests."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest, kurtosis

from noiseid_cli.diagnostics.consistency import autocorrelation, consistency
from noiseid_cli.diagnostics.misfit import misfit_sentences
from noiseid_cli.errors import EstimationError


def random_case(rng, lengths=(60, 35), ny=3, missing=0.2):
    nu, S = [], []
    for n in lengths:
        A = rng.normal(size=(n, ny, ny)) * 10.0 ** np.arange(-4, 2 * ny - 4, 2)[:, None]
        S_i = A @ A.transpose(0, 2, 1) + np.eye(ny) * 10.0 ** np.arange(-9, 4 * ny - 9, 4)
        nu_i = np.einsum("nij,nj->ni", np.linalg.cholesky(S_i), rng.normal(size=(n, ny)))
        nu_i[rng.random((n, ny)) < missing] = np.nan
        nu_i[3] = np.nan
        nu.append(nu_i)
        S.append(S_i)
    return nu, S


def slow(nu, S, lags):
    """The same figures by loops over single numbers."""
    ny = nu[0].shape[1]
    joint, per_time, r = 0.0, [], [[] for _ in range(ny)]
    count = 0
    for nu_i, S_i in zip(nu, S, strict=True):
        for i in range(ny):
            r[i].append([nu_i[t, i] / np.sqrt(S_i[t, i, i]) for t in range(len(nu_i))])
        for t in range(len(nu_i)):
            rows = [i for i in range(ny) if not np.isnan(nu_i[t, i])]
            if not rows:
                per_time.append(np.nan)
                continue
            v = nu_i[t, rows]
            d = float(v @ np.linalg.inv(S_i[t][np.ix_(rows, rows)]) @ v)
            joint += d
            count += len(rows)
            per_time.append(d / len(rows))
    rho, statistic = np.full((lags, ny), np.nan), np.zeros(ny)
    for i in range(ny):
        values = [x for test in r[i] for x in test if not np.isnan(x)]
        n, mean_square = len(values), np.mean(np.square(values))
        for k in range(1, lags + 1):
            pairs = [
                test[t] * test[t + k]
                for test in r[i]
                for t in range(len(test) - k)
                if not np.isnan(test[t] * test[t + k])
            ]
            rho[k - 1, i] = np.mean(pairs) / mean_square
            statistic[i] += rho[k - 1, i] ** 2 * len(pairs) * (n + 2) / n
    flat = [np.array([x for test in r[i] for x in test if not np.isnan(x)]) for i in range(ny)]
    return {
        "nis": joint / count,
        "observed": count,
        "nis_output": [np.mean(x**2) for x in flat],
        "autocorrelation": rho,
        "ljung_box": chi2.sf(statistic, lags),
        "kurtosis": [kurtosis(x) for x in flat],
        "nis_time": per_time,
    }


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lags", [1, 7, 20])
def test_equals_slow_loops(seed, lags):
    nu, S = random_case(np.random.default_rng(seed))
    fast = consistency("start", nu, S, -3.0, lags=lags)
    for name, value in slow(nu, S, lags).items():
        np.testing.assert_allclose(getattr(fast, name), value, rtol=1e-9, atol=1e-12, err_msg=name)
    assert (fast.label, fast.loglik, fast.path_error) == ("start", -3.0, None)
    assert np.isnan(fast.path_error_norm)


def test_covariance_of_missing_rows_is_not_read():
    nu, S = random_case(np.random.default_rng(1))
    spoilt = [S_i.copy() for S_i in S]
    for nu_i, S_i in zip(nu, spoilt, strict=True):
        gone = np.isnan(nu_i)
        S_i[gone[:, :, None] | gone[:, None, :]] = np.nan
    np.testing.assert_equal(vars(consistency("a", nu, spoilt, 0.0)), vars(consistency("a", nu, S, 0.0)))


def test_ljung_box_p_values_of_white_noise_are_uniform():
    rng = np.random.default_rng(3)
    r = rng.normal(size=(1000, 400))
    r[rng.random(r.shape) < 0.1] = np.nan
    rho, p = autocorrelation([r[:400], r[400:]], 20)
    assert kstest(p, "uniform").pvalue > 1e-3
    # E rho_k^2 n_k (n + 2) / n = 1; over 20 x 400 values its mean has a standard error of sqrt(2 / 8000)
    n = np.isfinite(r).sum(axis=0)
    seen = np.isfinite(r)
    for k in (1, 20):
        n_k = sum((part[k:] & part[:-k]).sum(axis=0) for part in (seen[:400], seen[400:]))
        assert abs(np.mean(rho[k - 1] ** 2 * n_k * (n + 2) / n) - 1) < 4 * np.sqrt(2 / 400)


def test_ar1_is_found_at_its_own_correlation():
    rng = np.random.default_rng(4)
    n, phi = 20_000, 0.3
    x = np.empty(n)
    x[0] = rng.normal() / np.sqrt(1 - phi**2)
    for t in range(1, n):
        x[t] = phi * x[t - 1] + rng.normal()
    rho, p = autocorrelation([x[:, None]], 5)
    # Bartlett: var(rho_1) = (1 - phi^2) / n for AR(1)
    assert abs(rho[0, 0] - phi) < 4 * np.sqrt((1 - phi**2) / n)
    assert abs(rho[1, 0] - phi**2) < 4 * np.sqrt((1 + 2 * phi**2) / n)
    assert p[0] < 1e-100


@pytest.mark.parametrize("factor", [0.25, 1.0, 9.0])
def test_nis_scales_with_the_claimed_covariance(factor):
    rng = np.random.default_rng(5)
    A = rng.normal(size=(2, 2))
    S = A @ A.T
    nu = rng.normal(size=(5000, 2)) @ np.linalg.cholesky(S).T
    result = consistency("a", [nu], [np.broadcast_to(factor * S, (5000, 2, 2))], 0.0)
    assert abs(result.nis * factor - 1) < 4 * np.sqrt(2 / 10_000)
    assert np.all(np.abs(result.nis_output * factor - 1) < 4 * np.sqrt(2 / 5000))
    assert np.all(np.abs(result.kurtosis) < 4 * np.sqrt(24 / 5000))


def test_tests_are_never_paired_across_their_border():
    ones, minus = np.ones((4, 1)), -np.ones((4, 1))
    rho, _ = autocorrelation([ones, minus], 5)
    np.testing.assert_allclose(rho[:3, 0], 1.0)
    assert np.isnan(rho[3:, 0]).all()


def test_path_error_is_joined_and_normed():
    nu, S = random_case(np.random.default_rng(6))
    error = [np.full(60, 3.0), np.full(35, 4.0)]
    result = consistency("truth", nu, S, 0.0, path_error=error)
    assert result.path_error is not None
    assert len(result.path_error) == 95
    assert result.path_error_norm == pytest.approx(np.sqrt(60 * 9 + 35 * 16))


def test_nothing_observed_gives_no_figure():
    result = consistency("a", [np.full((5, 2), np.nan)], [np.full((5, 2, 2), np.nan)], 0.0)
    assert result.observed == 0
    for value in (result.nis, result.nis_output, result.autocorrelation, result.ljung_box, result.kurtosis):
        assert np.isnan(value).all()
    assert misfit_sentences(result, ["a", "b"], 0.1) == [
        "No measurement was used, so nothing can be said about the misfit."
    ]


@pytest.mark.parametrize("bad", [np.diag([1.0, -1.0]), np.ones((2, 2)) * [[1, 2], [2, 1]], np.full((2, 2), np.nan)])
def test_indefinite_covariance_is_named(bad):
    S = np.broadcast_to(np.eye(2), (9, 2, 2)).copy()
    S[6] = bad
    with pytest.raises(EstimationError, match=r"estimate values .* test 2, sample 7"):
        consistency("estimate", [np.zeros((3, 2)), np.zeros((9, 2))], [S[:3], S], 0.0)


def test_lags_must_be_positive():
    with pytest.raises(EstimationError, match="lags is 0"):
        consistency("a", [np.zeros((3, 1))], [np.ones((3, 1, 1))], 0.0, lags=0)


def evaluate(nu, label="estimate"):
    n, ny = nu.shape
    return consistency(label, [nu], [np.broadcast_to(np.eye(ny), (n, ny, ny))], 0.0)


def test_sentences_for_white_innovations_find_nothing():
    nu = np.random.default_rng(7).normal(size=(2000, 2))
    assert misfit_sentences(evaluate(nu), ["q1", "q2"], 0.01) == [
        "No misfit was found: the prediction errors have the expected size and are independent over time."
    ]


def test_sentences_name_size_colour_tails_and_time():
    rng = np.random.default_rng(8)
    n = 4000
    echo = rng.normal(size=n)
    echo[3:] += 0.8 * echo[:-3]
    late = rng.normal(size=n) * np.where(np.arange(n) >= 3600, 4.0, 1.0)
    sentences = misfit_sentences(
        evaluate(np.column_stack([echo, late, 0.5 * rng.normal(size=n)])), ["a", "b", "c"], 0.1
    )
    text = "\n".join(sentences)
    assert "a: the prediction errors (innovations) are not independent over time" in text
    assert "lag of 3 samples (0.3 s)" in text
    assert "b: large prediction errors are more frequent than normal noise has them (heavy tails" in text
    assert "over-confident" in next(s for s in sentences if s.startswith("b: NIS"))
    assert "under-confident" in next(s for s in sentences if s.startswith("c: NIS"))
    assert "samples 3601 to 4000" in text
    flat = misfit_sentences(evaluate(rng.uniform(-1.7, 1.7, size=(n, 1))), ["a"], 0.1)
    assert "light tails" in flat[0]


@pytest.mark.parametrize(("label", "expected"), [("estimate", True), ("start", False)])
def test_nis_of_one_with_colour_is_called_no_proof(label, expected):
    white = np.random.default_rng(9).normal(size=4001)
    nu = ((white[1:] + 0.5 * white[:-1]) / np.sqrt(1.25))[:, None]
    sentences = misfit_sentences(evaluate(nu, label), ["a"], 0.1)
    assert any("stands in for model error" in s for s in sentences) is expected


def test_a_gap_is_not_taken_for_uneven_misfit():
    nu = np.random.default_rng(10).normal(size=(2000, 1))
    nu[:900] = np.nan
    assert not any("uneven" in s for s in misfit_sentences(evaluate(nu), ["a"], 0.1))
