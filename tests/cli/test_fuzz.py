"""A few of the inputs that `make fuzz` makes."""

import pytest

from tests.cli import fuzzing


@pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning")
@pytest.mark.parametrize(
    ("target", "inputs"),
    [("readers", 50), ("models", 30), ("command_line", 15)],
)
def test_damaged_input_ends_in_a_result_or_in_an_error_that_says_why(
    target: str, inputs: int
) -> None:
    before = fuzzing.outcomes[target].copy()
    fuzzing.run(target, inputs)
    made = fuzzing.outcomes[target] - before
    assert made.total() >= inputs / 2
    assert len(made) == 2  # some of either kind
