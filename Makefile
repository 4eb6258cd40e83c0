# `make reproduce` and `make test` work on a fresh clone: they make .venv, install pinned versions, and run.
PYTHON ?= python3
BIN := .venv/bin
PLACES := src tests benchmarks examples docs/_extensions
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
INSTALL := $(PIP) install --no-compile -c constraints.txt # what is imported is compiled then
unexport PYTHONDONTWRITEBYTECODE # each of the many processes would compile all modules anew

.PHONY: reproduce validate test test-long test-settings lint format coverage mutations bench docs faults constraints dist clean

reproduce: .venv/core
	$(BIN)/nontwist reproduce --force

# Every known truth, measured afresh; writes docs/validation.md.
validate: .venv/core
	$(BIN)/nontwist validate --page docs/validation.md --force

test: .venv/all
	$(BIN)/python -m pytest -m "not long" --durations=10

test-long: .venv/all
	$(BIN)/python -m pytest --durations=10

# The quick suite on one core, on a busy machine, as another user, without HOME, ...: up to an hour; ONLY="loaded nobody"
# runs these settings alone.
test-settings: .venv/all
	$(BIN)/python tests/settings.py $(ONLY)

# Which lines of the heart the tests run: texts of kernels as they are traced, and on floats.
coverage: .venv/all
	cd tests && ../$(BIN)/python -m coverage run --source=../src/nontwist --data-file=../.coverage -m pytest -q -n 0 \
		kernels/test_kernel_texts.py exact/test_exact.py geometry/test_frames.py integrators/test_lie_midpoint.py \
		integrators/test_energy_momentum.py integrators/test_gauss.py integrators/test_split.py \
		integrators/test_derivatives.py -m "not long"
	$(BIN)/python -m coverage report --include="*/kernels/*,*/engine/*,*/integrators/*,*/geometry/*,*/exact/*"

# All goals, measured beside other tools; writes docs/performance.md and docs/performance/.
bench: .venv/bench
	$(BIN)/python -m benchmarks --page

# Faults planted in the package one at a time, and which of them the quick suite finds: about an hour.
mutations: .venv/all
	$(BIN)/python tests/mutations.py

# Everything that can go wrong around a run, made to happen; writes docs/faults.md.
faults: .venv/all
	PYTHONPATH=tests $(BIN)/python -m faults

lint: .venv/all
	$(BIN)/ruff check $(PLACES)
	$(BIN)/ruff format --check $(PLACES)
	$(BIN)/mypy
	$(BIN)/lint-imports

format: .venv/all
	$(BIN)/ruff check --fix $(PLACES)
	$(BIN)/ruff format $(PLACES)

# The site, in build/docs, in four processes: warnings are errors, tutorials run, nothing is fetched.
docs: .venv/all
	$(BIN)/python -m sphinx -W --keep-going -j 4 -b html docs build/docs

# The versions that all is tested with; names and versions only, no addresses.
constraints:
	rm -rf .venv
	$(PYTHON) -m venv .venv
	$(PIP) install --upgrade pip
	$(PIP) install -e ".[all,bench]"
	$(BIN)/python -m pip --disable-pip-version-check list --format=freeze --exclude-editable --exclude setuptools > constraints.txt
	touch .venv/core .venv/all .venv/bench

dist: .venv/all
	rm -rf dist build/empty
	$(INSTALL) build
	$(BIN)/python -m build --outdir dist
	for package in dist/*.whl dist/*.tar.gz; do \
		$(PYTHON) -m venv --clear build/empty && \
		build/empty/bin/python -m pip --disable-pip-version-check --quiet install -c constraints.txt $$package && \
		build/empty/bin/nontwist --version && build/empty/bin/nontwist validate --group paper || exit 1; \
	done

clean:
	rm -rf .venv build dist

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "nontwist needs Python 3.11 or newer; try: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(INSTALL) --upgrade pip # which resolves in half the time of the one that comes with Python 3.11

.venv/core: .venv/bin/python pyproject.toml constraints.txt
	$(INSTALL) -e .
	touch $@

.venv/all: .venv/bin/python pyproject.toml constraints.txt
	$(INSTALL) -e ".[all]"
	touch .venv/core $@

.venv/bench: .venv/all
	$(INSTALL) -e ".[all,bench]"
	touch $@
