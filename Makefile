# `make reproduce` and `make test` work on a fresh clone: they make .venv, install pinned versions, and run.
PYTHON ?= python3
BIN := .venv/bin
PLACES := src tests benchmarks examples
BITCODE := src/nontwist/bitcode/manifest.json
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
INSTALL := $(PIP) install --no-compile -c constraints.txt # what is imported is compiled then
BUILD := $(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"])'
# What the package needs with the extras that are named, one of which may name others: nontwist[a,b].
NEEDS := $(BIN)/python -c 'import sys, tomllib; p = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	of = lambda name: [one for need in p["optional-dependencies"][name] for one in (sum(map(of, need[9:-1].split(",")), []) \
	if need.startswith("nontwist[") else [need])]; print(*p["dependencies"], *sum(map(of, sys.argv[1:]), []))'
# Installs the package: its kernels are compiled while what it needs is unpacked; then they are there.
PACKAGE = (PYTHONPATH=src $(BIN)/python -m nontwist.bitcode & $(INSTALL) $$($(NEEDS) $(1)) && wait $$!) && \
	$(INSTALL) --no-build-isolation --no-deps -e .
unexport PYTHONDONTWRITEBYTECODE # each of the many processes would compile all modules anew

.PHONY: reproduce validate test test-long test-settings lint format coverage bench docs faults constraints dist clean

reproduce: .venv/core $(BITCODE)
	$(BIN)/nontwist reproduce --force

# Every known truth, measured afresh; writes docs/validation.md.
validate: .venv/core $(BITCODE)
	$(BIN)/nontwist validate --page docs/validation.md --force

test: .venv/all $(BITCODE)
	$(BIN)/python -m pytest -m "not long" --durations=10

test-long: .venv/all $(BITCODE)
	$(BIN)/python -m pytest --durations=10

# The quick suite on one core, on a busy machine, as another user, without HOME, ...: up to an hour; ONLY="loaded nobody"
# runs these settings alone. Puts the results into CONTRIBUTING.md.
test-settings: .venv/all $(BITCODE)
	$(BIN)/python tests/settings.py $(ONLY)

# Which lines of the kernels the tests run: their text uncompiled, as Numba shows no lines.
coverage: .venv/all
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run --source=src/nontwist -m pytest -q -n 0 \
		tests/test_lie_midpoint.py tests/test_energy_momentum.py tests/test_split.py tests/test_exact.py tests/test_frames.py \
		-k "not million and not orthonormal and not drift and not state and not orders and not refused and not quotient" || true
	$(BIN)/python -m coverage report --include="*kernel*"

# All goals, measured beside other tools; writes docs/performance.md and docs/performance/.
bench: .venv/bench $(BITCODE)
	$(BIN)/python -m benchmarks --page

# Everything that can go wrong around a run, made to happen; writes docs/faults.md.
faults: .venv/all $(BITCODE)
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
docs: .venv/all $(BITCODE)
	$(BIN)/python -m sphinx -W --keep-going -j 4 -b html docs build/docs

# The versions that all is tested with; names and versions only, no addresses.
constraints:
	rm -rf .venv
	$(PYTHON) -m venv .venv
	$(PIP) install -e ".[all,bench]"
	$(BIN)/python -m pip --disable-pip-version-check list --format=freeze --exclude-editable --exclude pip --exclude setuptools > constraints.txt
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
	rm -rf .venv build dist src/nontwist/bitcode/*/ $(BITCODE)

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "nontwist needs Python 3.11 or newer; try: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv .venv

# What builds the package is installed beside it: in an environment of its own, Numba would be installed a second time.
.venv/build: .venv/bin/python pyproject.toml constraints.txt
	$(INSTALL) editables $$($(BUILD))
	touch $@

.venv/core: .venv/build
	$(call PACKAGE,compile)
	touch $@

.venv/all: .venv/build
	$(call PACKAGE,all)
	touch .venv/core $@

# The kernels as bitcode, with the manifest that is written last: made anew for the modules whose text has changed, so
# that nothing below runs an old one, or compiles while it runs.
$(BITCODE): .venv/core $(wildcard src/nontwist/*/*.py)
	$(BIN)/python -m nontwist.bitcode
	touch $@

.venv/bench: .venv/all
	$(INSTALL) $$($(NEEDS) all bench)
	touch $@
