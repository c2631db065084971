# `make demo` runs the main job, `make test` every check; both set up .venv first if need be.
# `make figures` writes the figures of the documents from the result files.
# `make paper` lists what is there of the paper's tables and figures, and what the rest would take.
# `make docs` runs the blocks of the pages again, compares, and builds the site: docs/_build/html/index.html.
# `make desks` runs exported FMUs as Windows (under wine) and Linux do; it needs wine, and ziglang.
# `make claims` measures what README.md claims of accuracy again, `make claims-all` all that is stored.
# `make fuzz` looks for failures at random, `make soak` repeats what takes long: both for minutes.
PYTHON ?= python3
BIN := .venv/bin
# The public records, where a copy lies beside the checkout; without one they are downloaded.
ifneq ($(wildcard ../shared/data),)
export SPLITBAND_DATA_DIR ?= $(abspath ../shared/data)
endif

.PHONY: axe demo test suite check kernels format figures docs paper bench claims claims-all fuzz soak memory desks clean

demo: .venv/.ready
	$(BIN)/splitband demo --out demo

test:
	$(MAKE) --jobs=2 check kernels
	$(BIN)/pytest -n auto

# The tests alone, on a Python for which the checks have run elsewhere.
suite: kernels
	$(BIN)/pytest -n auto

# Otherwise each worker of the suite would compile for itself what is not on disk yet.
kernels: .venv/.ready
	$(BIN)/splitband doctor --quiet

check: .venv/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(BIN)/mypy
	for each in win32 darwin; do $(BIN)/mypy --platform $$each --follow-imports=skip \
	    --cache-dir .mypy_cache/$$each src/splitband/runtime/system.py || exit 1; done

format: .venv/.ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

figures: .venv/.ready
	$(BIN)/python -m reproduction table all --no-run --update --out docs/results
	$(BIN)/python -m reproduction horizons --update --out docs/results
	$(BIN)/python -m docs.tables

docs: .venv/.ready
	$(BIN)/python -m docs.run --check
	$(BIN)/python -m sphinx -b html --fresh-env --fail-on-warning --keep-going docs docs/_build/html

paper: .venv/.ready
	$(BIN)/python -m reproduction list --out docs/results

bench: .venv/.ready
	mkdir -p docs/benchmarks
	$(BIN)/python -m benchmarks.rollout --out docs/benchmarks/rollout.json
	$(BIN)/python -m benchmarks.state_space --out docs/benchmarks/state_space.json

# What README.md claims of accuracy, and what else the documents do: on a quiet machine, for hours,
# which they print first. What is there, of today's code, is not measured again; then `make figures`.
claims: .venv/.ready
	$(BIN)/python -m benchmarks.clock --records tanks5 silverbox "drill string" tanks "van der Pol" --budgets 2m 10m

claims-all: claims
	$(BIN)/python -m benchmarks.clock
	$(BIN)/python -m benchmarks.clock --beside 2 --budgets 30s 2m --seeds 1
	$(BIN)/python -m benchmarks.against --libraries splitband --seeds 5
	$(BIN)/python -m benchmarks.families
	$(BIN)/python -m benchmarks.recommendation
	$(BIN)/python -m benchmarks.recommendation --methods default --seeds 3 --skip 5

fuzz: .venv/.ready
	$(BIN)/pytest -n auto -m hypothesis --hypothesis-profile explore
	$(BIN)/python -m tests.cli.fuzzing --inputs 9360 --out docs/benchmarks/fuzz.json

soak: .venv/.ready
	$(BIN)/pytest -n auto -m soak

memory: .venv/.ready
	$(BIN)/python -m benchmarks.memory --out docs/benchmarks/memory.json

desks: .venv/.ready
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[everywhere]'
	$(BIN)/python -m benchmarks.desks --out docs/benchmarks/desks.json

.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[dev]'
	touch $@

clean:
	rm -rf .venv demo out docs/_build .mypy_cache .ruff_cache .pytest_cache

# The checker of accessibility that the browser tests use where it is there.
axe:
	npm install --no-save --no-package-lock --ignore-scripts axe-core@4
