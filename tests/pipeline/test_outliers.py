"""The outlier gate in an experiment."""

from dataclasses import replace

import numpy as np
import pytest

from noiseid_cli.pipeline.context import open_experiment
from noiseid_cli.pipeline.datasets import make_dataset
from noiseid_cli.pipeline.estimation import make_estimate
from noiseid_cli.pipeline.units import dataset_units, estimate_units
from noiseid_cli.storage.dataset_file import read_dataset, write_dataset
from noiseid_cli.storage.result_file import read_result

ESTIMATE_R = "estimate.measurement_noise={start: {std: [1e-3]}}"


def spoil(context):
    """Simulate, and put two outliers of 50 standard deviations into the file."""
    unit = dataset_units(context)[0]
    make_dataset(context, unit)
    dataset = read_dataset(unit.path)
    r = dataset.recordings[0]
    y = r.y.copy()
    y[20, 0] += 0.05
    y[55, 0] -= 0.05
    write_dataset(unit.path, replace(dataset, recordings=(replace(r, y=y),)), {})


@pytest.mark.parametrize("per", ["sample", "output"])
def test_outliers_are_left_out_alike_everywhere_and_told(small, per):
    gate = f"estimate.outlier_gate={{probability: 1e-7, per: {per}}}"
    off, on = (open_experiment(small, small.parent, (ESTIMATE_R, *more)) for more in ((), (gate,)))
    spoil(off)
    plain = make_estimate(off, estimate_units(off)[0])
    unit = estimate_units(on)[0]
    gated = make_estimate(on, unit)
    assert plain.estimate.final.R[0, 0] > 10 * 1e-6
    assert gated.estimate.final.R[0, 0] == pytest.approx(1e-6, rel=0.8)
    assert "outliers" not in plain.estimate.trace
    assert gated.estimate.trace["outliers"][:, :3].tolist() == [[1, 21, 1], [1, 56, 1]]
    told = [s for s in gated.estimate.safeguards if "outlier gate" in s]
    assert f"probability 1e-07 per {per}): 2 of 80 measurements left out" in told[0]
    assert "x at 0.2 s (+" in told[0]
    # Two of eighty are more than one in a hundred.
    assert "so many are no outliers" in told[1]
    # The filter of the evaluation sees what the fit saw.
    assert [gated.evaluations[at].observed for at in ("start", "estimate", "truth")] == [78, 78, 78]
    assert gated.evaluations["estimate"].loglik == pytest.approx(gated.estimate.loglik, abs=1e-9)
    assert np.array_equal(read_result(unit.path).estimate.trace["outliers"], gated.estimate.trace["outliers"])


def test_clean_data_gives_the_same_bits(small):
    off, on = (open_experiment(small, small.parent, more) for more in ((), ("estimate.outlier_gate={}",)))
    make_dataset(off, dataset_units(off)[0])
    plain, gated = (make_estimate(c, estimate_units(c)[0]) for c in (off, on))
    assert np.array_equal(plain.estimate.final.Q, gated.estimate.final.Q)
    assert gated.estimate.safeguards[-1].endswith("none of 80 measurements left out")


def test_gate_and_held_out_end_go_together(small):
    """Outliers are left out of the fitted part; the held-out end is scored whole, those in it too."""
    gate, holdout = "estimate.outlier_gate={probability: 1e-7}", "estimate.holdout={last: 0.5}"
    plain, both = (open_experiment(small, small.parent, (ESTIMATE_R, holdout, *more)) for more in ((), (gate,)))
    spoil(plain)
    result = make_estimate(both, estimate_units(both)[0])
    assert result.estimate.trace["outliers"][:, :3].tolist() == [[1, 21, 1]]
    assert result.evaluations["estimate"].observed == 39
    assert result.held_out["estimate"].observed == 40
    assert result.held_out["estimate"].nis > 10.0 > result.evaluations["estimate"].nis
