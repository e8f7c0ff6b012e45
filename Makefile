# make run    install; run the economic NMPC of the 5-bus system; save trajectories and a figure
# make test   install the test dependencies; run the tests except the slow ones
# make test-examples  run the properties with ten times as many random examples
# make fuzz   run mutated inputs for SECONDS (300); write the counts to docs/inputs.md
# make check  check style, types and layers
# make table  run the closed loops of the paper's four systems; write docs/paper-table.md and its figures
# make bench  run all benchmarks on an idle machine; write docs/benchmarks.md
# make generated  write JSON Schemas and the tables of the documentation from declarations
# make docs   build the documentation as a site in build/site; a broken link is an error
# make pglib  solve the PGLib cases that have no result yet; write docs/pglib.md
PYTHON ?= python3
BIN := .venv/bin
SECONDS ?= 300
PARALLEL ?= -n auto --maxprocesses 4 --dist worksteal
# Many of the slow tests wait for processes that they started.
PARALLEL_SLOW ?= -n 4 --dist worksteal

# The processes that tests start need not compile this package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test test-slow test-examples fuzz check table bench generated docs pglib clean

run: .venv/.run
	$(BIN)/opfmodel run scenarios/case5-step.yaml

test: .venv/.test
	$(BIN)/python -m pytest -q $(PARALLEL) -m "not slow"

test-slow: .venv/.slow
	$(BIN)/python -m pytest -q $(PARALLEL_SLOW) -m slow

test-examples: .venv/.test
	$(BIN)/python -m pytest -q $(PARALLEL) -m "hypothesis and not slow" --hypothesis-profile thorough

fuzz: .venv/.test
	$(BIN)/python -m tests.fuzz --seconds $(SECONDS) --docs docs/inputs.md

check: .venv/.check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

table: .venv/.run
	$(BIN)/python -m benchmarks.paper

bench: .venv/.bench
	for name in compile receding growth windows tree security peers warm_start profile backends study page; do \
		$(BIN)/python -m benchmarks.$$name || exit 1; done

generated: .venv/.run
	$(BIN)/python docs/generate.py

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo build/site/index.html

pglib: .venv/.bench
	$(BIN)/python -m benchmarks.pglib

clean:
	rm -rf .venv results

# One environment, installed in steps. A step is repeated only when the package metadata change.
.venv/.made:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "opfmodel needs Python 3.11 or newer")'
	$(PYTHON) -m venv .venv
	touch $@

.venv/.run: .venv/.made setup.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

.venv/.test: .venv/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	touch $@

.venv/.docs: .venv/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

.venv/.slow: .venv/.test
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[slow]'
	touch $@

.venv/.bench: .venv/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[benchmark]'
	touch $@

.venv/.check: .venv/.run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[check]'
	touch $@
