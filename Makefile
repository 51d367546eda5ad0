# Targets make their own set-up: only Python 3.11+ and make are needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEV_STAMP := $(VENV)/.installed-dev
CLIENTS_VENV := .venv-clients
CLIENTS_STAMP := $(CLIENTS_VENV)/.installed
DOCS_VENV := .venv-docs
DOCS_STAMP := $(DOCS_VENV)/.installed
DIST := build/dist
export OPENBLAS_NUM_THREADS := 1

.PHONY: help install install-dev run demo-check test test-all mutants console-check clients lint types imports locks check dist coverage bench nightly docs map hooks schema archive lock clean

help: ## show the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "%-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

$(STAMP): requirements-extras.lock pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-extras.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-build.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@echo compiling the filter, about a minute after an installation, so that the first row does not wait for it
	$(BIN)/python -m service.pipeline.first_rows
	touch $@

$(DEV_STAMP): $(STAMP) requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-dev.lock
	touch $@

# third-party programs: their dependencies must not move the product's
$(CLIENTS_STAMP): requirements-clients.lock
	test -x $(CLIENTS_VENV)/bin/python || $(PYTHON) -m venv $(CLIENTS_VENV)
	$(CLIENTS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-clients.lock
	touch $@

$(DOCS_STAMP): requirements-docs.lock
	test -x $(DOCS_VENV)/bin/python || $(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-docs.lock
	touch $@

install: $(STAMP) ## install the service with all extras

install-dev: $(DEV_STAMP) ## install the tools too

run: $(STAMP) ## start the demonstration: simulated analyzer, front end, service
	$(BIN)/soo demo

demo-check: $(STAMP) ## half a virtual day in closed loop; JSON, exit 1 when bounds are missed
	$(BIN)/soo demo --exit --json --days 0.5

# prints wall time and processor time of all processes; durations of each test go to build/durations
PYTEST := $(BIN)/python tests/processor_time.py $(BIN)/python -m pytest
PARALLEL := $(PYTEST) -n 2 --dist worksteal
DURATIONS := build/durations
REPORT := --junitxml=$(DURATIONS)

test: $(DEV_STAMP) ## run the tests of every change
	$(PARALLEL) $(REPORT)/quick.xml -m "not nightly and not slow"

test-all: export SOO_TEST_PROFILE := ci
test-all: $(DEV_STAMP) ## run the slow tests too, as continuous integration does
	$(PARALLEL) $(REPORT)/all.xml -m "not nightly and not alone"

mutants: $(DEV_STAMP) ## put sixty errors into the code, one at a time; print the test that finds each
	$(BIN)/python tests/mutation/mutants.py

console-check: $(DEV_STAMP) ## look at the console in the system's chromium; pictures in build/console
	$(PYTEST) -p no:randomly -m "not nightly" -n 2 --dist loadfile $(REPORT)/console.xml tests/console

# without unraisableexception: the sockets that a client leaves to the collector are its own
clients: $(STAMP) $(CLIENTS_STAMP) ## drive the simulated analyzer with third-party programs, print what each did
	SOO_ANALYZER=$(BIN)/soo-analyzer $(CLIENTS_VENV)/bin/python -m pytest -p no:unraisableexception $(REPORT)/clients.xml tests/clients

lint: $(DEV_STAMP) ## style and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV_STAMP) ## static types
	$(BIN)/mypy

imports: $(DEV_STAMP) ## import rules
	$(BIN)/lint-imports

locks: ## lock files name no address
	! grep -n '://' requirements*.lock

check: lint types imports locks test-all docs ## all that must hold before a change lands

# the wheel is built from the sdist, apart from the checkout: what was built before cannot get into it
dist: $(DEV_STAMP) ## build wheel and sdist into build/dist, with the locks of what they need
	$(BIN)/uv build --quiet --offline --no-build-isolation --python $(BIN)/python --out-dir $(DIST)
	cp requirements.lock requirements-extras.lock $(DIST)

coverage: $(DEV_STAMP) ## branch coverage of core, pipeline and records
	SOO_TEST_PROFILE=ci $(BIN)/python -m pytest -m "not nightly and not system" -n 2 -q --cov --cov-report=term-missing:skip-covered

bench: $(DEV_STAMP) ## ratios, measured in one run; times of single computations; what floods cost others
	$(BIN)/python -m bench
	$(BIN)/python -m pytest -q -s -p no:randomly tests/growth tests/system/test_attacks_floods.py

# every step runs, whatever failed before it; the table says which
nightly: export SOO_TEST_PROFILE := nightly
nightly: $(DEV_STAMP) $(CLIENTS_STAMP) ## long tests, repeated evidence, new examples of every property; writes docs/evidence/nightly.md
	rm -rf $(DURATIONS)
	-$(PARALLEL) $(REPORT)/nightly.xml -m "nightly and not alone"
	-$(PYTEST) $(REPORT)/alone.xml -m "alone"
	-$(PYTEST) $(REPORT)/console.xml -p no:randomly -m nightly -n 2 --dist loadfile tests/console
	-$(PARALLEL) $(REPORT)/properties.xml -m "not nightly" tests/property
	-$(MAKE) clients
	$(BIN)/python tests/durations.py --page docs/evidence/nightly.md $(DURATIONS)/*.xml

docs: $(DOCS_STAMP) ## build the documents as a searchable offline site, build/site/index.html; broken links fail
	NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/bin/mkdocs build

map: $(DEV_STAMP) ## draw the packages and their imports into the documents
	$(BIN)/python -m docs.package_map docs

hooks: $(DEV_STAMP) ## check every commit before it is made (.pre-commit-config.yaml)
	$(BIN)/pre-commit install

schema: $(STAMP) ## write the OpenAPI document and the client's types of its answers
	$(BIN)/soo openapi --output docs/reference/openapi.json
	$(BIN)/python -m docs.client_types

archive: $(DEV_STAMP) ## make the archive new that the tests open and estimate from
	PYTHONPATH=tests/fakes/worlds:tests/fakes/drivers:tests/fakes/ports $(BIN)/python -m fixture_archive

lock: $(DEV_STAMP) ## resolve and pin again
	$(BIN)/uv pip compile pyproject.toml --all-extras $(LOCK_OPTIONS) -o requirements-extras.lock
	# of the service and of a front end: no figures, no cluster, no data frames
	$(BIN)/uv pip compile pyproject.toml --extra station --extra console -c requirements-extras.lock $(LOCK_OPTIONS) -o requirements.lock
	$(BIN)/uv pip compile --group dev -c requirements-extras.lock $(LOCK_OPTIONS) -o requirements-dev.lock
	$(BIN)/uv pip compile --group build -c requirements-dev.lock $(LOCK_OPTIONS) -o requirements-build.lock
	$(BIN)/uv pip compile --group clients $(LOCK_OPTIONS) -o requirements-clients.lock
	$(BIN)/uv pip compile --group docs $(LOCK_OPTIONS) -o requirements-docs.lock

LOCK_OPTIONS := --quiet --generate-hashes --no-emit-index-url --no-header --universal --python-version 3.11

clean: ## remove what was built
	rm -rf $(VENV) $(CLIENTS_VENV) $(DOCS_VENV) build *.egg-info .cache .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
