# armrig: `make demo` and `make test` need Debian's python3, python3-venv, make and a C compiler.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test check bench simulate format clean

demo: .venv/run
	$(BIN)/armrig demo

test: .venv/dev
	$(BIN)/pytest

check: .venv/dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/python -m armrig_protocol.generate --check
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/dev
	PYTHONPATH=tests/integration $(BIN)/python tests/benchmarks/one_kilohertz.py

# SEEDS=1000 schedules of drawn faults; SEED=… runs one again and writes its story.
SEEDS ?= 1000
simulate: .venv/dev
	PYTHONPATH=tests OPENBLAS_NUM_THREADS=1 $(BIN)/python -m simulator $(if $(SEED),--seed $(SEED),--seeds $(SEEDS))

format: .venv/dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/python -m armrig_protocol.generate

clean:
	rm -rf .venv demo

# What a user needs; the wheels come with the first call and again when pyproject.toml changes.
.venv/run: pyproject.toml | .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	touch $@

# What a developer needs beside it.
.venv/dev: pyproject.toml | .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@ .venv/run

.venv:
	$(PYTHON) -m venv .venv
