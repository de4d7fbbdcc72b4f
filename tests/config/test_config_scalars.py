import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noiseid_cli.config.scalars import ScalarError, resolve
from noiseid_cli.config.yaml_loader import parse_yaml

VALUES = [
    ("1e-3", 0.001),
    ("1e3", 1000.0),
    ("5E-7", 5e-7),
    ("1E-10", 1e-10),
    ("2e-10", 2e-10),
    ("1.0e3", 1000.0),
    ("+1e-3", 0.001),
    ("-2.5", -2.5),
    (".5", 0.5),
    ("-.5e-3", -0.0005),
    ("1.", 1.0),
    ("1.e-3", 0.001),
    ("0", 0),
    ("-0", 0),
    ("0.0", 0.0),
    ("-0.0", -0.0),
    ("0e400", 0.0),
    ("+7", 7),
    ("-12", -12),
    ("9999999999999999999", 9999999999999999999),
    ("4.9e-324", 5e-324),
    ("1.7976931348623157e308", 1.7976931348623157e308),
    ("true", True),
    ("True", True),
    ("FALSE", False),
    ("null", None),
    ("~", None),
    ("NULL", None),
    (".nan", math.nan),
    (".inf", math.inf),
    ("-.INF", -math.inf),
    ("no", "no"),
    ("off", "off"),
    ("on", "on"),
    ("yes", "yes"),
    ("y", "y"),
    ("nan", "nan"),
    ("inf", "inf"),
    ("1_000", "1_000"),
    ("1:30", "1:30"),
    ("190:20:30.15", "190:20:30.15"),
    ("2024-01-01", "2024-01-01"),
    ("2001-12-14t21:59:43.10-05:00", "2001-12-14t21:59:43.10-05:00"),
    ("1e", "1e"),
    ("1e+", "1e+"),
    (".", "."),
    ("1.2.3", "1.2.3"),
    ("tRUE", "tRUE"),
    ("=", "="),
    ("١٢", "١٢"),  # digits of another script are no digits here
]

REFUSED = [
    ("010", "needless zero"),
    ("007", "needless zero"),
    ("-01.5", "needless zero"),
    ("00", "needless zero"),
    ("0x1F", "not a decimal number"),
    ("0o17", "not a decimal number"),
    ("0b11", "not a decimal number"),
    ("99999999999999999999", "20 digits"),
    ("-100000000000000000000000000000", "1.5e29"),
    ("1e400", "larger than"),
    ("-1.0e+400", "larger than"),
    ("1e-400", "smaller than"),
    ("0." + "3" * 500, "502 characters"),
]


@pytest.mark.parametrize(("text", "value"), VALUES)
def test_unquoted_words_have_one_meaning(text, value):
    got = parse_yaml(f"a: {text}", "f").data["a"]
    assert type(got) is type(value)
    if isinstance(value, float):
        assert struct.pack("d", got) == struct.pack("d", value)
    else:
        assert got == value


@pytest.mark.parametrize(("text", "said"), REFUSED)
def test_words_with_two_readings_are_refused(text, said):
    with pytest.raises(ScalarError, match=said):
        resolve(text)
    document = parse_yaml(f"a: {text}\nb: 1", "f")
    assert [p.path for p in document.problems] == ["a"]
    assert document.data["b"] == 1


@pytest.mark.parametrize("text", ["1e-3", "no", "010", "null", "0x1F", ""])
def test_quotes_make_text(text):
    assert parse_yaml(f"a: '{text}'", "f").data["a"] == text
    assert parse_yaml(f'a: "{text}"', "f").data["a"] == text


@given(st.floats(allow_nan=False, allow_infinity=False))
@settings(max_examples=500)
def test_every_double_comes_back_bit_for_bit(value):
    assert struct.pack("d", float(resolve(repr(value)))) == struct.pack("d", value)
