# make demo | test | lint work on a fresh machine: each makes .venv and installs what it needs first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# What a user needs, without what only developing needs.
RUN_STAMP := $(VENV)/.installed-to-run
# Without bytecode of what is never imported, which is most of it: that of a module is written when it is first read.
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# Mesh of thesis and exp1 to exp3: coarse or full.
MESH ?= full
# Drawn experiments of each of exp1 and exp3.
DRAWS ?= 40
# Test processes that run side by side; with nothing compiled two took 10 min on two cores, 19 min of CPU in all (docs/tests.md). 0: one process.
JOBS ?= 2

# Strict: a link or an anchor that leads nowhere is an error. The theme's note on its successor is no news in every build.
MKDOCS = NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# One thread per linear algebra call: the systems are small, and several processes or numba threads share the cores.
export OPENBLAS_NUM_THREADS = 1
export OMP_NUM_THREADS = 1
export MKL_NUM_THREADS = 1
# Tests start dozens of interpreters: each would read all modules anew.
unexport PYTHONDONTWRITEBYTECODE
# Idle OpenMP threads would spin and slow down everything that runs beside them.
export OMP_WAIT_POLICY = PASSIVE

.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow as-written nightly reliability reliability-quick lowest licences lint docs format schema bench coverage dead-ends mutations exp1 exp2 exp3 thesis real clean

help:
	@echo "make demo              identify a small virtual experiment, raw files to table and figures"
	@echo "make test              quick tests          make test-slow   the tests that take minutes"
	@echo "make as-written        tutorial, notebooks, wheel in an empty environment, exports, and the report in a browser"
	@echo "make lint              style, types, import contract, documentation site"
	@echo "make docs              the documentation site, build/site/index.html"
	@echo "make format            format the sources   make schema      rewrite the schemas and the generated pages of docs/"
	@echo "make thesis            sections 5.3 to 5.5 of the thesis, tables and figures to docs/reproduction [MESH=coarse: minutes]"
	@echo "make bench             timings              make exp1 | exp2 | exp3   one section of them"
	@echo "make coverage          do the intervals hold the truth? 40 drawn experiments each of exp1 and exp3, to docs/coverage.md (hours; resumes)"
	@echo "make dead-ends         fifty random materials and starts whose law lacks something strong: does the chain come to an end?"
	@echo "make reliability       faults, mutated inputs, references, sameness, memory, mutations: docs/reliability.md (an hour; it resumes)"
	@echo "make nightly           all tests, the slow ones too, and runs/nightly.md      make licences   docs/licences.md, docs/sbom.json"
	@echo "make mutations         do the tests notice wrong formulas and rules? (docs/tests.md; tens of minutes)"
	@echo "make real              records measured by others, from THERMOFIT_DATA: parameters with intervals, effects that are missing"
	@echo "make clean             remove .venv and caches; runs/ is kept"

install: $(STAMP)

# The stamps make this a no-op until pyproject.toml changes.
$(RUN_STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "thermofit needs Python >= 3.11, found " + sys.version.split()[0] + ": make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -e .
	touch $@

$(STAMP): $(RUN_STAMP)
	$(INSTALL) -e '.[dev]'
	touch $@

demo: $(RUN_STAMP)
	$(BIN)/thermofit run configs/quickstart.yaml

test: install
	$(BIN)/python -m pytest -q -n $(JOBS)

# The notebooks and the fields for ParaView are tried here alone: what they need is large.
test-slow: install
	$(INSTALL) -e '.[dev,notebook,paraview]'
	$(BIN)/python -m pytest -q -n $(JOBS) -m slow

# A part of the slow tests that every change has to pass. Without a Chromium the report is not looked at, and the tests say so.
as-written: install
	$(INSTALL) -e '.[dev,notebook,paraview]'
	$(BIN)/python -m pytest -q -n $(JOBS) -m as_written

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MKDOCS)

docs: install
	$(MKDOCS)
	@echo "documentation: build/site/index.html"

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

schema: install
	$(BIN)/python scripts/write_schema.py

bench: install
	$(INSTALL) -e '.[bench]'
	$(BIN)/python scripts/bench.py --write docs/performance.md

# Finished draws are rows of docs/coverage.jsonl: remove it to begin anew.
coverage: install
	$(BIN)/python scripts/interval_coverage.py --draws $(DRAWS)
	$(BIN)/python scripts/interval_coverage.py --draws 8 --mesh full
	$(BIN)/python scripts/interval_coverage.py --draws 12 --interpolation three-point

dead-ends: install
	$(BIN)/python -m pytest -q -n $(JOBS) -m slow tests/stages/test_dead_ends.py

nightly: install
	$(INSTALL) -e '.[dev,notebook,paraview]'
	$(BIN)/python scripts/nightly.py -n $(JOBS)

# Runs unattended and goes on where it was stopped; exit 1 where anything is not as it should be.
reliability: install
	$(BIN)/python scripts/reliability.py --jobs $(if $(filter 0,$(JOBS)),1,$(JOBS))

# The part of it that every change has to pass, beside the quick tests of faults, hostile files and reference figures.
reliability-quick: install
	$(BIN)/python scripts/reliability_inputs.py --number 200
	$(BIN)/python scripts/reliability_kept.py force points pipe aliases

# The lowest versions that pyproject.toml allows. Their own deprecation warnings are no failures: versions beside them are the newest.
lowest: install
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/lowest
	$(BIN)/uv pip install --quiet --resolution lowest-direct --python build/lowest/bin/python -e '.[dev]'
	build/lowest/bin/python -m pytest -q -n $(JOBS) -W ignore::DeprecationWarning tests/read tests/records tests/cli tests/study tests/core
	build/lowest/bin/thermofit run configs/quickstart.yaml --run-dir build/lowest/quickstart

# Of the environment as it is installed; uv.lock holds the versions with which it was tested.
licences: install
	$(BIN)/python scripts/bill_of_materials.py > docs/sbom.json
	$(BIN)/python scripts/bill_of_materials.py --page > docs/licences.md

# Wrong edits of a kept list, one at a time in a copy of the tree; exit 1 where the tests notice fewer than 95 %. It resumes.
mutations: install
	$(BIN)/python scripts/mutations.py --jobs $(if $(filter 0,$(JOBS)),1,$(JOBS))

# Sections 5.3, 5.4, 5.5 of the thesis; the pages go to docs/reproduction. A run that was stopped goes on where it was.
exp1 exp2 exp3: install
	$(BIN)/python scripts/thesis.py $@ --mesh $(MESH)

thesis: install
	$(BIN)/python scripts/thesis.py --mesh $(MESH)

# Exit 5 says that a record holds more than the model: the next study still runs.
real: install
	@if [ ! -d "$${THERMOFIT_DATA:-}/real" ]; then \
	  echo "make real: left out, because THERMOFIT_DATA does not name a folder that holds real/: export THERMOFIT_DATA=FOLDER"; \
	else for study in configs/real-*.yaml; do \
	  for command in run $$(grep -q '^diagnosis:' $$study && echo close-loop); do \
	  $(BIN)/thermofit $$command $$study; status=$$?; case $$status in 0|5) ;; *) exit $$status;; esac; done; done; fi

clean:
	rm -rf $(VENV) build dist .pytest_cache .hypothesis .mypy_cache .ruff_cache .import_linter_cache .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
