"""Claims of a published source, alone or with what was found."""

import pytest

from noiseid_cli.config.published import load_published
from noiseid_cli.errors import ConfigError
from noiseid_cli.pipeline.facts import claim_sentences


def written(folder, text):
    file = folder / "published.yaml"
    file.write_text("source: a book\nclaims:\n" + text)
    return file


def test_what_was_found_stands_behind_the_claim(tmp_path):
    file = written(tmp_path, "  - It converges.\n  - {claim: It is fast., found: 'over ten seeds, 2 s.'}\n")
    assert claim_sentences(load_published(file)) == [
        "It converges.",
        "It is fast. Found by the shipped experiment: over ten seeds, 2 s.",
    ]


def test_half_a_claim_is_a_mistake_with_its_place(tmp_path):
    with pytest.raises(ConfigError, match=r"published\.yaml:3:5: claims\.0"):
        load_published(written(tmp_path, "  - {claim: It is fast.}\n"))
