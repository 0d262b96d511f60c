# armrig: `make demo` and `make test` need Debian's python3, python3-venv, make and a C compiler.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test check bench format clean

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
