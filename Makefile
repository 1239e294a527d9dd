# `make demo` and `make test` do their own set-up in .venv; PYTHON chooses the interpreter it is made from.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL ?= $(BIN)/python -m pip install --quiet --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help demo test test-all lint docs docs-test bench notebooks clean

help: ## say what there is
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/'

demo: $(BIN)/.installed ## the whole lecture: derivation, verification, six runs, figures under out/
	$(BIN)/pinmobile lecture

# Each processor has a process: threads of linear algebra would only wait for one another.
test test-all docs: export OPENBLAS_NUM_THREADS = 1

test: $(BIN)/.installed-test ## the tests on all processors, without the long ones
	$(BIN)/python -m pytest -n logical --dist loadfile --no-loadscope-reorder -m "not long" $(ARGS)

test-all: $(BIN)/.installed-test ## all tests on all processors
	$(BIN)/python -m pytest -n logical --dist loadfile --no-loadscope-reorder $(ARGS)

lint: $(BIN)/.installed-lint ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(ARGS)

docs: $(BIN)/.installed-docs ## the documentation site, under out/site
	$(BIN)/python docs/build.py $(ARGS)

docs-test: $(BIN)/.installed-docs ## the built site in a browser
	$(BIN)/python -m pytest -p no:cacheprovider docs/test_site.py $(ARGS)

bench: $(BIN)/.installed-bench ## speed beside the peers that are installed, as ratios of one run
	$(BIN)/python benchmarks $(ARGS)

notebooks: $(BIN)/.installed-test ## execute the notebooks' sources and write the .ipynb files
	$(BIN)/python notebooks/execute.py $(ARGS)

clean: ## remove .venv, out/ and caches
	rm -rf $(VENV) out .mypy_cache .pytest_cache .ruff_cache .hypothesis

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(BIN)/.installed: $(BIN)/python pyproject.toml
	@echo "setting up $(VENV): a minute or two, once"
	$(INSTALL) --editable .
	@touch $@

$(BIN)/.installed-test: $(BIN)/python pyproject.toml
	@echo "setting up $(VENV) for the tests: a minute or two, once"
	$(INSTALL) --editable '.[test]'
	@touch $@ $(BIN)/.installed

$(BIN)/.installed-docs: $(BIN)/python pyproject.toml
	@echo "setting up $(VENV) for the site: a minute or two, once"
	$(INSTALL) --editable '.[docs]'
	@touch $@ $(BIN)/.installed

$(BIN)/.installed-bench: $(BIN)/python pyproject.toml
	$(INSTALL) --editable .
	@touch $@ $(BIN)/.installed

$(BIN)/.installed-lint: $(BIN)/python pyproject.toml
	$(INSTALL) --editable '.[lint]'
	@touch $@ $(BIN)/.installed $(BIN)/.installed-test
