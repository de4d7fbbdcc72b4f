"""The table of the process noise in both units."""

from dataclasses import replace

import pytest
from report_cases import simulated

from noiseid_cli.report.noise_units import noise_units_table, unit_words


def cells(study):
    table = noise_units_table(study)
    return table, {row[1]: row for row in table.rows}


def test_both_units_from_either():
    study = simulated()
    sampled = replace(study, results=[replace(study.results[0], interval=0.04)])
    _, rows = cells(sampled)
    row = rows["va1"]
    assert row[4] == pytest.approx(0.2 * row[2])
    assert (row[3], row[5]) == ("N m", "N m/√Hz")
    names = tuple((name, f"{unit}/√Hz", text) for name, unit, text in study.results[0].noise_names)
    table, rows = cells(
        replace(study, results=[replace(study.results[0], interval=0.04, density=True, noise_names=names)])
    )
    assert rows["va1"][4] == row[2], "now the estimate itself is the density"
    assert rows["va1"][2] == pytest.approx(5 * row[2])
    assert (rows["va1"][3], rows["va1"][5]) == ("N m", "N m/√Hz")
    assert "interval of 0.04 s" in table.caption


def test_no_table_where_nothing_converts():
    study = simulated()
    assert all(r.interval is None for r in study.results)
    assert noise_units_table(study) is None


def test_words_for_captions():
    study = simulated()
    assert unit_words(study) == "per sample"
    assert unit_words(replace(study, results=[replace(r, density=True) for r in study.results])) == "as a density"
