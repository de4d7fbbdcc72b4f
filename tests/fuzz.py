"""`make fuzz`: many hostile inputs, part by part, with a line on each; and how many inputs a test takes.

In the suite each of these tests takes few inputs. Here FUZZ_EXAMPLES says how many, and FUZZ_SEED which ones; a
number that was tried is tried again in the same way.
"""

import io
import os
import sys
import time
from contextlib import redirect_stderr, redirect_stdout

import pytest

SEED = int(os.environ.get("FUZZ_SEED", "0"))

PARTS = {
    "experiments, mutated, before check": "config/test_config_fuzz.py",
    "linear models, spoilt, before check": "config/test_model_fuzz.py::test_linear_models_are_taken_or_refused",
    "linear models of any shape, run": "config/test_model_fuzz.py::test_linear_models_of_any_shape_run",
    "model files, spoilt, before check": "config/test_model_fuzz.py::test_model_files_are_taken_or_refused",
    "CSV logs before import": "recordings/test_recording_fuzz.py::test_tables_are_imported_or_refused",
    "CSV logs before init --from": (
        "recordings/test_recording_fuzz.py::test_an_experiment_is_made_of_a_table_or_refused"
    ),
    "MAT files before import": "recordings/test_recording_fuzz.py::test_mat_files_are_imported_or_refused",
    "our files, damaged": "storage/test_file_fuzz.py::test_damaged_files_of_ours_end_in_a_sentence",
    "HDF5 logs, damaged": ("storage/test_file_fuzz.py::test_damaged_files_of_others_end_in_a_sentence_or_in_numbers"),
    "calls to the disk that fail, each in a run": (
        "commands/test_failing_disk.py::test_whichever_call_fails_the_run_ends_with_1_and_goes_on_to_the_same_bytes"
    ),
}
"""What is tried, and the test that tries it."""


def fuzzing() -> bool:
    """Many inputs are asked for."""
    return "FUZZ_EXAMPLES" in os.environ


def examples(usual: int, part: int = 1) -> int:
    """Number of inputs that a test takes: the usual one in the suite, else FUZZ_EXAMPLES over ``part``, at least that.

    Args:
        usual: in the suite.
        part: greater where an input takes longer.
    """
    return max(usual, int(os.environ["FUZZ_EXAMPLES"]) // part) if fuzzing() else usual


class Heard:
    """Adds up what the tests of a part have tried."""

    inputs = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the number that the fixture ``tried`` has left."""
        if report.when == "teardown":
            self.inputs += sum(value for name, value in report.user_properties if name == "inputs")


def main() -> int:
    """Run all parts; the output of pytest is shown of those that fail only."""
    width = max(map(len, PARTS))
    print(f"{'part':{width}}  {'inputs':>7}  {'time':>6}  result", flush=True)
    failed = 0
    for words, test in PARTS.items():
        heard, said, began = Heard(), io.StringIO(), time.monotonic()
        with redirect_stdout(said), redirect_stderr(said):
            code = pytest.main(["-q", "-p", "no:cacheprovider", f"--hypothesis-seed={SEED}", f"tests/{test}"], [heard])
        took = f"{time.monotonic() - began:.0f} s"
        print(f"{words:{width}}  {heard.inputs:>7}  {took:>6}  {'FAILED' if code else 'ok'}", flush=True)
        failed += bool(code)
        if code:
            print(said.getvalue(), flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
