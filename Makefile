# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO_ARGS ?=
PYTEST := $(BIN)/python -m pytest
LOCK := $(BIN)/python -m uv pip compile --quiet --no-header --generate-hashes --constraint constraints.txt \
	--python-version 3.11 --python-platform x86_64-manylinux_2_28
SHORT := not timing and not endurance and not laboratory and not thorough
# Hundreds of processes load the same modules: each must find them compiled.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo demo-fleet check test test-all test-more test-long test-timing seconds lint types house compiled kernels docs descriptions clean lock release pictures

demo: $(VENV)/.installed-run
	@$(BIN)/bearing-twin demo $(DEMO_ARGS)

# Several cells with PostgreSQL, NATS and Dask, all of them on this machine.
demo-fleet: $(VENV)/.installed-fleet
	@$(BIN)/bearing-twin demo-fleet $(DEMO_ARGS)

# Before each commit: what needs no socket, no other process and no browser.
check: lint
	$(PYTEST) --numprocesses=2 -m "not wires and not browser and $(SHORT)"

# The types are checked on one core while another compiles the kernels, and the tests themselves: each
# worker would do that again. What fails has a second look (tools/gate.py). A part:
# make test TESTS="tests/service/store".
test: $(VENV)/.installed-test
	@$(MAKE) --no-print-directory --jobs=2 lint compiled
	$(BIN)/python -m tools.gate $(TESTS)

# Before a release: `make test`, and then what takes long; gates of time one by one, on quiet cores.
test-all: test
	@$(MAKE) --no-print-directory test-more

test-more: test-long test-timing

test-long: $(VENV)/.installed-test
	$(PYTEST) --numprocesses=3 -m "not timing and not ($(SHORT))"

test-timing: $(VENV)/.installed-test
	$(PYTEST) -m timing

# Keeps what the last runs measured as the seconds that the order of the tests follows from.
seconds:
	cp build/test-seconds.json tests/seconds.json

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Types of the page's modules, with those of the REST answers (npm ci --prefix tests/page).
types: $(VENV)/bin/python
	$(BIN)/python -m tools.page_types build/page/api.d.ts
	tests/page/node_modules/.bin/tsc --project service/web/pages

# The figures that show whether the house is in order: mass, names, words, where features stand.
house: $(VENV)/bin/python
	@$(BIN)/python -m tools.house

docs: $(VENV)/.installed-test
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --quiet docs build/docs
	@echo "build/docs/index.html"

# What /openapi.json and /asyncapi.json show, the types of the Python client, and the schema of model
# files; tests show every difference.
descriptions: $(VENV)/.installed-test
	$(BIN)/python -m service.web.api.descriptions docs
	$(BIN)/python client/generate_documents.py
	$(BIN)/python -m service.offline.model_schema docs

# What the image installs, with hashes, and what it is: after a change of the dependencies.
lock: $(VENV)/.installed-test
	$(BIN)/python -m pip install --quiet uv
	$(LOCK) pyproject.toml --extra fleet --extra mqtt --extra opcua --extra report --output-file requirements.lock
	echo hatchling | $(LOCK) - --output-file build.lock
	$(BIN)/python -m tools.bill_of_materials

# The pictures of README and docs, from the demo: five minutes, with Chromium.
pictures: $(VENV)/.installed-test
	$(BIN)/python -m tools.pictures

# As a user installs it: wheel and source archive, hashes, fresh environments, the demo in each.
release: $(VENV)/.installed-test
	$(BIN)/python -m tools.try_release

compiled: kernels
	@$(PYTEST) --collect-only --quiet >/dev/null

kernels: $(VENV)/.installed-test
	$(BIN)/python -m service warm-up

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=python3.11 ..." >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV) || \
		{ rm -rf $(VENV); echo "No venv module: on Debian install it with 'apt-get install python3-venv'" >&2; exit 2; }

$(VENV)/.installed-run: $(VENV)/bin/python pyproject.toml laboratory/pyproject.toml constraints.txt
	@echo "Installing into $(VENV) ..." >&2
	@$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[report]' --editable laboratory >&2
	@touch $@

$(VENV)/.installed-fleet: $(VENV)/bin/python pyproject.toml laboratory/pyproject.toml constraints.txt
	@echo "Installing into $(VENV) ..." >&2
	@$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[fleet,report,servers]' --editable laboratory >&2
	@touch $@ $(VENV)/.installed-run

$(VENV)/.installed-test: $(VENV)/bin/python pyproject.toml laboratory/pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]' --editable laboratory
	@touch $@ $(VENV)/.installed-run $(VENV)/.installed-fleet

clean:
	rm -rf $(VENV) build dist var .mypy_cache .ruff_cache .pytest_cache
