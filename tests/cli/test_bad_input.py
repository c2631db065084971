"""Bad input ends in one line and exit status 2, and leaves no file."""

from typing import Any

import pytest

from tests.cli.support import (
    AHEAD,
    DRIVEN_AHEAD,
    FIT,
    GRU,
    HYBRID_AHEAD,
    SIMULATOR,
    SPLIT,
    assert_fails,
)

pytestmark = pytest.mark.usefixtures("inside")

MEAN = "compare record.csv --columns a --methods mean "
LIKE = "fit record.csv --out m --like driven "
FORECAST = "forecast record.csv --columns a --out out --steps 5 "
BESIDE = "simulate --out ran.csv --record record.csv --inputs force "


def bad(line: str, *says: str) -> Any:
    """A command line that must fail with a line that holds every one of `says`."""
    return pytest.param(line, says, id=line or "nothing")


RECORDS = [
    bad("compare nothing.csv --out out", "RECORD", "nothing.csv"),
    bad("compare record.csv --test folder --out out", "--test must be a file", "the folder folder"),
    bad("compare record.csv --columns torque --out out", "record.csv", "'torque'", "'a'"),
    bad("compare record.csv --columns a --inputs a --out out", "column 'a'", "twice"),
    bad("compare worded.csv --columns a --out out", "worded.csv", "'a'", "row 9", "'oops'"),
    bad("compare untimed.csv --out out", "untimed.csv", "--sampling-time", "--time-column"),
    bad("compare van-der-pol --columns a --out out", "--columns", "van-der-pol", "got a"),
]

SETTINGS = [
    bad(SPLIT + "--train 201", "--train must be between 2 and 200", "got 201"),
    bad(SPLIT + "--train 20", "window", "20 samples", "got 30"),
    bad(SPLIT + "--horizon 51", "--horizon", "at most 50", "got 51"),
    bad(SPLIT + "--methods splt-gru,mean", "--methods", "'splt-gru' (did you mean split-gru?)"),
    bad(GRU + "--cutoff 7", "cutoff", "got 7"),
    bad("compare record.csv --columns a --order 2", "--order must be left out", "--methods"),
    bad(SPLIT + "--cutoff 1 --downsampling 5", "downsampling by 5", "1 Hz", "at most 4"),
    bad(SPLIT + "--warmup many", "--warmup", "valid integer", "got many"),
    bad(SPLIT + "--hidden 4", "--hidden", "LOW,HIGH", "got 4"),
    bad(SPLIT + "--hidden 4,0", "--hidden must be LOW,HIGH", "from 1", "got 4,0"),
    bad(SPLIT + "--methods ''", "--methods must be", "got ''"),
    bad(SPLIT + "--methods ,", "--methods must be", "got ','"),
    bad(MEAN + "--inputs force --train 200 --horizon 5", "--horizon must", "splitband forecast"),
    bad(MEAN + "--unwrap a=turn", "--unwrap must be NAME or NAME=PERIOD, got a=turn"),
    bad(MEAN + "--train 100 --horizon 50 --refit", "--refit must be", "got 50", "splitband fit"),
    bad("inspect record.csv --columns a --train 0 --out out", "--train must be", "got 0"),
    bad(GRU + "--learning-rate 1e30", "diverged", "learning rate", "1e+30"),
    bad(GRU + "--own-warmup no", "--own-warmup must be left out", "split-gru", "got gru"),
]

WORDS = [
    bad(SPLIT + "--train abc", "--train", "a whole number of samples or all", "got abc"),
    bad(SPLIT + "--speed 3", "--speed"),
    bad(SPLIT + "--epoch 3", "--epoch", "Possible options: --epochs"),
    bad("check gru record.csv", "Missing option '--record'"),
    bad("fit record.csv simulated.csv --method mean --out m", "(simulated.csv)"),
    bad("compare", "RECORD"),
    bad("learn record.csv", "learn"),
    bad("", "command"),
    bad("compare '[/b] :car:.csv'", "[/b] :car:.csv"),
]

OUTPUTS = [
    bad(GRU + "--out record.csv/below", "--out", "record.csv/below"),
    bad(f"{GRU} --out {'x' * 300}", "--out", "xxx"),
    bad(AHEAD + "history.csv --out record.csv/below.csv", "--out", "record.csv"),
    bad("export gru record.csv/rig.c", "OUT must be a folder that can be written"),
]

SIMULATORS = [
    bad(f"{GRU} --methods filtered-gru", "filtered-gru", "--simulator"),
    bad(SIMULATOR + "nothing.csv", "--simulator", "nothing.csv"),
    bad(SIMULATOR + "simulated.csv --more record.csv --more-simulator linear", "is a baseline"),
    bad(f"{GRU} --simulator-start 5", "--simulator must be given"),
    bad(SIMULATOR + "broken.py:good", "broken.py", "SyntaxError"),
    bad(SIMULATOR + "functions.py:good --simulator-start noon", "start must be a number of sec"),
    bad(SIMULATOR + "simulated_short.csv", "simulated_short.csv", "0 s to 19.9 s", "0 s to 18.9 s"),
    bad(SIMULATOR + "simulated_names.csv", "--simulator-columns", "1 of p, q"),
    bad(SIMULATOR + "functions.py:raising", "200 samples", "RuntimeError", "no convergence after"),
    bad(SIMULATOR + "functions.py:hanging --simulator-timeout 0.2", "simulator", "0.2 s"),
    bad(SIMULATOR + "functions.py:good --simulator-timeout -1", "--simulator-timeout"),
    bad(SIMULATOR + "functions.py:equation", "--parameters must say where the states"),
    bad(SIMULATOR + "damaged.fmu", "damaged.fmu", "zip"),
    bad(SIMULATOR + "hollow.fmu", "hollow.fmu"),
]

MODELS = [
    bad(f"{FIT} --method simulator", "--simulator", "must be given for simulator"),
    bad(FIT + "--method filtered-gru-calibrated", "filtered-gru-calibrated", "--simulator"),
    bad("fit record.csv --columns a --out out", "--method must be named", "compare", "methods"),
    bad(FIT + "--seed 99999999999999999999", "seed", "9999"),
    bad("fit record.csv --columns a --out out --method gru --device meta", "--device", "meta"),
    bad(LIKE + "--inputs b", "is for inputs: force; outputs: a", "the record has inputs: b;"),
    bad(LIKE + "--columns a,b", "outputs: a, the record has inputs: force; outputs: a, b"),
    bad("fit history_renamed.csv --like driven --out m", "is for inputs: force", "'a' is unknown"),
    bad(DRIVEN_AHEAD.replace("history.", "history_renamed."), "'z'", "inputs: force; outputs: a"),
    bad("simulate nothing --history history.csv --steps 5 --out ahead.csv", "nothing"),
    bad(AHEAD + "history_slow.csv", "history_slow.csv", "0.1 s", "0.2 s"),
    bad(AHEAD + "history.csv --steps 0", "--steps"),
    bad(AHEAD + "history.csv --level 0.8", "--level must be left out", "held-out errors"),
    bad(AHEAD + "history.csv --simulator functions.py:good", "--simulator", "left out for gru"),
    bad(AHEAD + "history.csv --future-inputs future.csv", "--future-inputs", "no known inputs"),
    bad("forecast record.csv --columns a --out out", "--steps"),
    bad("forecast record.csv --columns a --out out --steps 5 --method best", "got 'best'"),
    bad(FORECAST + "--inputs force", "(force)", "--future-inputs FILE"),
    bad(FORECAST + "--method linear", "--inputs"),
    bad(FORECAST + "--method filtered-gru --simulator simulated.csv", "to 20.4 s", "to 19.9 s"),
    bad("inspect record.csv --columns a --out out --simulator harmonic", "harmonic", "baseline"),
    bad(HYBRID_AHEAD, "--simulator", "filtered-gru"),
    bad(HYBRID_AHEAD + "--steps 190 --simulator simulated.csv", "must cover", "0 s to 19.9 s"),
    bad(DRIVEN_AHEAD, "--future-inputs", "force"),
    bad(DRIVEN_AHEAD + "--future-inputs simulated.csv", "simulated.csv", "'force'"),
    bad(DRIVEN_AHEAD + "--future-inputs future_short.csv", "--future-inputs", "must cover"),
    bad(DRIVEN_AHEAD + "--future-inputs future_bare.csv", "time stamps", "--time-column ''"),
    bad("export gru 1.c", "path must be named as functions of C are, such as model_1.c"),
    bad("export gru rig.fmu --precision float", "--precision must be double for an FMU"),
    bad("export filtered rig.c", "its time is calibrated", "gain and offset alone"),
]


SIMULATED = [
    bad("simulate --out ran.csv", "MODEL_DIR must be given, or --record and --simulator"),
    bad(BESIDE, "--record and --simulator", "got --record record.csv, --simulator none"),
    bad("simulate --out ran.csv --simulator functions.py:good", "got --record none, --simulator"),
    bad(BESIDE + "--simulator linear", "which is a baseline"),
    bad(BESIDE + "--simulator functions.py:good --level 0.9", "--level must be left out"),
    bad(BESIDE + "--simulator functions.py:driven --steps 5", "--steps", "end with it; got 5"),
    bad("simulate gru --out ran.csv --record record.csv", "--record must be left out", "MODEL_DIR"),
    bad("simulate gru --out ran.csv --columns a", "--columns must be left out", "got a"),
    bad("simulate gru --out ran.csv", "--steps must be given"),
]


@pytest.mark.usefixtures("model", "hybrid_model", "driven_model")
@pytest.mark.parametrize(
    ("line", "says"), [*RECORDS, *SETTINGS, *WORDS, *OUTPUTS, *SIMULATORS, *MODELS, *SIMULATED]
)
def test_bad_input_is_one_line_and_leaves_no_file(
    line: str, says: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert_fails(line, says, capsys)
