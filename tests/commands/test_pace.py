"""Counts, rate and time left, told now and then."""

from pathlib import Path

import pytest

from noiseid_cli.commands.pace import Pace, in_words
from noiseid_cli.pipeline.making import Token


def test_the_sentence_has_counts_rate_and_time_left():
    now = [0.0]
    pace = Pace("estimate", 500, 100, lambda: now[0])
    assert (pace.rate(), pace.sentence()) == ("", "")
    for k in range(20):
        now[0] += 1.0
        pace.count(Token("u", Path("u"), "failed" if k % 10 == 0 else "made"))
    assert pace.rate() == "1/s"
    assert pace.sentence() == "estimate: 118 of 500 done, 2 failed, 1/s, about 6 min left"
    assert pace.sentence() == ""  # it was said a moment ago
    now[0] += 100.0
    assert pace.sentence().endswith("10/min, about 38 min left")


def test_nothing_is_said_at_the_end():
    now = [0.0]
    pace = Pace("estimate", 1, 0, lambda: now[0])
    now[0] = 60.0
    pace.count(Token("u", Path("u"), "made"))
    assert pace.sentence() == ""
    assert pace.rate() == "1/min"


@pytest.mark.parametrize(("seconds", "words"), [(0.4, "0 s"), (89, "89 s"), (180, "3 min"), (9000, "2.5 h")])
def test_durations_in_words(seconds, words):
    assert in_words(seconds) == words
