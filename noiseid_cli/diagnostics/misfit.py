"""What the remaining misfit of a filter says, in plain sentences.

A prediction error, or innovation, is a measurement less what the filter expected just before it; the NIS is its square
over the variance that the filter gives for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from noiseid_cli.diagnostics.evaluation import Evaluation

SIGNIFICANCE = 0.01
"""Ljung-Box p-value below which innovations are called coloured."""

STANDARD_ERRORS = 3.0
"""A mean this many standard errors off its expectation is called off."""

SLOW, SLOW_ERRORS = 5, 5.0
"""Correlation that averages more than so many standard errors from this lag on is called slow."""

STRETCHES = 10

UNEVEN = 0.25
"""Misfit whose NIS scatters over the ranges of a quantity by this share of its mean is said to follow it."""

_HELD_OUT = {
    "inside": "the filter's idea of its own error holds there too",
    "outside": "the filter's idea of its own error does not hold there",
}


def misfit_sentences(evaluation: Evaluation, output_names: Sequence[str], dt: float | None) -> list[str]:
    """Say what is left unexplained: size, colour and tails of the innovations, and where in time.

    Args:
        evaluation: one filter over one dataset.
        output_names: (ny,) names of the outputs.
        dt: interval between samples, s, to turn lags into times; None where it is not known.

    Returns:
        Sentences, in that order; one that says so when nothing was found.
    """
    if not evaluation.observed:
        return ["No measurement was used, so nothing can be said about the misfit."]
    coloured = _colour(evaluation, output_names, dt)
    found = [*_size(evaluation, output_names), *coloured, *_tails(evaluation, output_names)]
    motion = _motion(evaluation)
    found += [*_where(evaluation), *motion]
    if not found:
        return ["No misfit was found: the prediction errors have the expected size and are independent over time."]
    if (coloured or motion) and evaluation.label == "estimate":
        what = " and ".join(["hang together over time"] * bool(coloured) + ["follow the motion"] * bool(motion))
        found.append(
            f"On average the prediction errors have the expected size (mean NIS {evaluation.nis:.3g}), but they "
            f"{what}: the estimated Q then stands in for model error as well as for noise. A NIS of 1 on the data that "
            "was fitted proves nothing: the fit makes it so, be the model right or wrong."
        )
    return found


def held_out_sentences(fitted: Evaluation, held_out: dict[str, Evaluation]) -> list[str]:
    """What held-out data say of noise values: are they consistent there, and better than those in use or the start?

    Args:
        fitted: the filter on the data that was fitted.
        held_out: by label, filters on data that no method has seen.
    """
    own = held_out.get(fitted.label)
    if own is None or not own.observed:
        return []
    low, high = own.nis_bounds()
    verdict = "inside" if low <= own.nis <= high else "outside"
    out = [
        f"On data that no method has seen the NIS is {own.nis:.3g}, {verdict} its bounds {low:.3g} to {high:.3g}: "
        f"{_HELD_OUT[verdict]}."
    ]
    before = next((held_out[at] for at in ("tuning", "start") if at in held_out and at != fitted.label), None)
    if before is not None:
        gain = own.loglik - before.loglik
        word = "higher" if gain > 0 else "lower"
        whose = "the covariances in use" if before.label == "tuning" else "the start values"
        out.append(f"There its log-likelihood is {abs(gain):.4g} {word} than that of {whose}.")
        if gain <= 0:
            out.append("The estimate does not carry over: do not put it in place of what it was compared with.")
    return out


def _size(evaluation: Evaluation, names: Sequence[str]) -> list[str]:
    """NIS per output off 1: for white Gaussian innovations its standard error is sqrt(2 / n)."""
    tolerance = STANDARD_ERRORS * np.sqrt(2 * len(names) / evaluation.observed)
    out = []
    for name, nis in zip(names, evaluation.nis_output, strict=True):
        if np.isfinite(nis) and abs(nis - 1) > tolerance:
            verdict = "over-confident" if nis > 1 else "under-confident"
            factor = np.sqrt(nis)
            out.append(
                f"{name}: NIS {nis:.3g} instead of 1. The prediction errors are {factor:.3g} times as large as the "
                f"filter expects: it is {verdict}."
            )
    return out


def _colour(evaluation: Evaluation, names: Sequence[str], dt: float | None) -> list[str]:
    """Outputs whose innovations are not white, with the lag of the strongest correlation."""
    out = []
    for i, (name, p) in enumerate(zip(names, evaluation.ljung_box, strict=True)):
        if np.isfinite(p) and p < SIGNIFICANCE:
            rho = evaluation.autocorrelation[:, i]
            lag = int(np.nanargmax(np.abs(rho)))
            steps = "1 sample" if lag == 0 else f"{lag + 1} samples"
            time = "" if dt is None else f" ({(lag + 1) * dt:.3g} s)"
            p_text = f"p = {p:.2g}" if p >= 1e-12 else "p < 1e-12"
            out.append(
                f"{name}: the prediction errors (innovations) are not independent over time, as those of a right model "
                f"are (Ljung-Box test, {p_text}): most at a lag of {steps}{time}, where their correlation is "
                f"{rho[lag]:.2f}."
            )
            slow = rho[SLOW - 1 :][np.isfinite(rho[SLOW - 1 :])]
            # White innovations give a mean of 0 with a standard error of 1 / sqrt(n lags).
            chance = SLOW_ERRORS * np.sqrt(len(names) / max(evaluation.observed * len(slow), 1))
            if slow.size and slow.mean() > chance:
                out.append(
                    f"{name}: the correlation does not die out: it averages {slow.mean():.2f} over the lags {SLOW} to "
                    f"{len(rho)}. That is a slow error of the model, such as friction left out or an offset."
                )
    return out


def _tails(evaluation: Evaluation, names: Sequence[str]) -> list[str]:
    """Excess kurtosis off 0: for Gaussian innovations its standard error is sqrt(24 / n)."""
    tolerance = STANDARD_ERRORS * np.sqrt(24 * len(names) / evaluation.observed)
    out = []
    for name, kurtosis in zip(names, evaluation.kurtosis, strict=True):
        if np.isfinite(kurtosis) and kurtosis > tolerance:
            out.append(
                f"{name}: large prediction errors are more frequent than normal noise has them (heavy tails, excess "
                f"kurtosis {kurtosis:.3g}): outliers, or noise whose size varies."
            )
        elif np.isfinite(kurtosis) and kurtosis < -tolerance:
            out.append(
                f"{name}: large prediction errors are rarer than normal noise has them (light tails, excess kurtosis "
                f"{kurtosis:.3g}), as with quantisation or saturation."
            )
    return out


def _motion(evaluation: Evaluation) -> list[str]:
    """The state or input that the misfit follows most, if it does so beyond ``UNEVEN``."""
    moving = [misfit for misfit in evaluation.misfit if misfit.name != "time"]
    worst = max(moving, key=lambda misfit: misfit.unevenness, default=None)
    if worst is None or worst.unevenness < UNEVEN:
        return []
    low, high, nis = worst.worst()
    unit = f" {worst.unit}" if worst.unit else ""
    hint = ", such as friction" if worst.unit in ("rad/s", "m/s") else ""
    return [
        f"The misfit follows {worst.name}: between {low:.3g} and {high:.3g}{unit} the NIS is {nis:.3g}, against "
        f"{evaluation.nis:.3g} on the whole. Look at the model's terms in {worst.name}{hint}."
    ]


def _where(evaluation: Evaluation) -> list[str]:
    """The tenth of the time with most of the misfit, if its share is beyond chance."""
    measured = np.isfinite(evaluation.nis_time)
    nis = np.where(measured, evaluation.nis_time, 0.0)
    if len(nis) < STRETCHES or nis.sum() <= 0:
        return []
    borders = np.linspace(0, len(nis), STRETCHES + 1).round().astype(int)
    share = np.add.reduceat(nis, borders[:-1]) / nis.sum()
    expected = np.add.reduceat(measured.astype(float), borders[:-1]) / measured.sum()
    chance = expected + STANDARD_ERRORS * np.sqrt(2 * expected / evaluation.observed)
    worst = int(np.argmax(share - chance))
    if share[worst] <= chance[worst]:
        return []
    return [
        f"The misfit is uneven in time: samples {borders[worst] + 1} to {borders[worst + 1]} hold "
        f"{share[worst]:.0%} of the squared prediction errors and {expected[worst]:.0%} of the measurements."
    ]
