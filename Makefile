# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO_ARGS ?=
# Hundreds of processes load the same modules: each must find them compiled.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo demo-fleet test lint docs descriptions clean

demo: $(VENV)/.installed-run
	@$(BIN)/bearing-twin demo $(DEMO_ARGS)

# Several cells with PostgreSQL, NATS and Dask, all of them on this machine.
demo-fleet: $(VENV)/.installed-fleet
	@$(BIN)/bearing-twin demo-fleet $(DEMO_ARGS)

# The types are checked on one core while the kernels are compiled on another. Each worker runs services
# of several processes: more workers than cores make tests of faults and attacks wait for each other.
test: $(VENV)/.installed-test
	@$(MAKE) --no-print-directory --jobs=2 lint kernels
	$(BIN)/python -m pytest --numprocesses=2

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.installed-test
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --quiet docs build/docs
	@echo "build/docs/index.html"

# What /openapi.json and /asyncapi.json show, the types of the Python client, and the schema of model
# files; tests show every difference.
descriptions: $(VENV)/.installed-test
	$(BIN)/python -m service.web.api.descriptions docs
	$(BIN)/python client/generate_documents.py
	$(BIN)/python -m service.offline.model_schema docs

kernels: $(VENV)/.installed-test
	$(BIN)/python -m service warm-up

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=python3.11 ..." >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV) || \
		{ rm -rf $(VENV); echo "No venv module: on Debian install it with 'apt-get install python3-venv'" >&2; exit 2; }

$(VENV)/.installed-run: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "Installing into $(VENV) ..." >&2
	@$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable . >&2
	@touch $@

$(VENV)/.installed-fleet: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "Installing into $(VENV) ..." >&2
	@$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[fleet,servers]' >&2
	@touch $@ $(VENV)/.installed-run

$(VENV)/.installed-test: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	@touch $@ $(VENV)/.installed-run $(VENV)/.installed-fleet

clean:
	rm -rf $(VENV) build dist var .mypy_cache .ruff_cache .pytest_cache
