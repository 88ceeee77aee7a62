# make run    install into .venv and open the viewer on the bundled demo (no display: a preview PNG)
# make test   install, then format, lint, types and tests
# make check  format, lint and types only; make tests   tests only
# make test JOBS=1   the same in one process (2 otherwise)
# make soak   MINUTES (60) of a user at random, in real windows

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
MINUTES ?= 60
JOBS ?= 2
# Tests of a file stay in one process, in order: they share contexts and compiled kernels. Files in the order of
# tests/conftest.py.
SHARED := --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder
# Where nothing may be compiled to files, each of the hundreds of processes that tests start compiles the package.
unexport PYTHONDONTWRITEBYTECODE
# Without the build's warning that an editable installation is one.
INSTALL := PYTHONWARNINGS=ignore $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: run test tests test-all check format soak system-run system-test tables pictures clean

run: $(VENV)/.run-installed | system-run
	@$(BIN)/splatview $(SCENE)

# Types take three minutes of one core, so that tests run beside them.
test: $(VENV)/.dev-installed | system-test
	@$(MAKE) --no-print-directory --jobs $(JOBS) check tests

tests: $(VENV)/.dev-installed | system-test
	@$(BIN)/python -m pytest -q $(SHARED)

test-all: check | system-test
	@$(BIN)/python -m pytest -q $(SHARED) -m ""

check: $(VENV)/.dev-installed
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/ruff check --quiet .
	@$(BIN)/pyright --warnings

format: $(VENV)/.dev-installed
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

# What is generated in README.md, docs/ and NOTICE: figures from the JSON in assets/benchmarks, the reference
# of recipes from the operations, licences from the packages' metadata.
tables: $(VENV)/.dev-installed
	@$(BIN)/python tools/benchmark_docs.py README.md docs/*.md
	@$(BIN)/python tools/recipe_docs.py
	@$(BIN)/python tools/licences.py

# An hour of a user at random, in real windows; logs in soak/, the report in assets/benchmarks/soak.json.
soak: $(VENV)/.dev-installed | system-test
	@$(BIN)/python tools/soak/soak.py --minutes $(MINUTES)

# The pictures of README.md and docs/, by the program itself.
pictures: $(VENV)/.dev-installed | system-test
	@$(BIN)/python tools/readme/readme_pictures.py

system-run:
	@sh scripts/system-packages.sh run

system-test:
	@sh scripts/system-packages.sh test

$(BIN)/pip:
	@echo "setting up $(VENV): the first time takes a few minutes"
	@$(PYTHON) scripts/python_version.py
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.run-installed: pyproject.toml constraints.txt | $(BIN)/pip
	@$(INSTALL) --editable ".[train,film]"
	@touch $@

$(VENV)/.dev-installed: pyproject.toml constraints.txt | $(BIN)/pip
	@$(INSTALL) --editable ".[dev]"
	@# pyright cannot follow an editable install; it finds "splatview" through this link.
	@mkdir -p build/typing && ln -sfn ../.. build/typing/splatview
	@touch $@ $(VENV)/.run-installed

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .ruff_cache .hypothesis
