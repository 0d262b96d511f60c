# armrig: `make demo` and `make test` need Debian's python3, python3-venv, make and a C compiler.
PYTHON ?= python3
OTHER_PYTHON := name another Python, for example: make $(or $(firstword $(MAKECMDGOALS)),demo) PYTHON=python3.12
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --disable-pip-version-check

# Hundreds of processes are started. Each would compile armrig again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all exhaustive timed machine walk check coverage stored mutants bench timing fuzz simulate firmware simavr fil docs lock lowest audit release reproduce format clean

# FIRMWARE=1: the Uno's firmware in simavr is the device, in virtual time; `make fil` is made first.
demo: .venv/run $(if $(FIRMWARE),fil)
	$(BIN)/armrig demo $(if $(FIRMWARE),--firmware)

# Three tests at a time, because a quarter of their time is waiting. The order is drawn; ORDER=… (the
# seed in the first lines of a run) repeats an order. `make test-all` runs the other tests.
SEVERAL = $(BIN)/pytest -n 3 --dist worksteal -p randomly --randomly-dont-reset-seed $(if $(ORDER),--randomly-seed $(ORDER))
test: .venv/dev
	$(SEVERAL) -m "not exhaustive and not timed and not machine"

# The tests that `make test` leaves out. The timed tests run alone, also if an earlier test failed.
test-all: .venv/dev
	$(MAKE) exhaustive; exhaustive=$$?; $(MAKE) timed && exit $$exhaustive
# Grids, long walks and slow tests; as root, also those that an ordinary user skips.
exhaustive: .venv/dev
	$(SEVERAL) -m "(exhaustive or root) and not timed and not machine"
timed: .venv/dev
	$(BIN)/pytest -m timed tests/integration

# As root: the service under a systemd, and strangers on a network, each in a namespace of its own.
machine: .venv/dev
	$(BIN)/pytest -m machine -k "not empty" tests/systemd tests/integration

# As root, with Debian's debootstrap: every line of docs/service.md and access.md, and of
# README's first screen, on an empty Debian. It fetches packages: ten minutes.
walk: .venv/dev
	$(BIN)/pytest -m machine -k empty -o faulthandler_timeout=900 tests/systemd/test_walk.py tests/systemd/test_readme.py

check: .venv/dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/python -m armrig_protocol.generate --check
	$(BIN)/python -m armrig_daemon.configuration_reference --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python tests/rooms.py
	$(BIN)/python tests/arm_names.py
	$(BIN)/python tests/words.py
	$(BIN)/python tests/name_counts.py
	$(BIN)/python tests/budget.py

# Every branch of the core and of the device's state machine, without tests that add nothing to it.
coverage: .venv/dev
	$(BIN)/pytest -q -n 2 --dist worksteal tests/daemon tests/core/control --cov --cov-config=tests/coverage.toml $(addprefix --ignore=tests/daemon/, \
	  decisions/test_clockmap.py test_every_nth_call.py emulator/test_plant.py emulator/test_pty.py)

# Write the stored results of what the programs print, draw and compute again; read the difference.
stored: .venv/dev
	WRITE_STORED=1 $(BIN)/pytest -q $$(grep -rlE "clients.said import|WRITE_STORED" tests --include="test_*.py")
	$(BIN)/python -m tests.same_numbers --write

# N mutants by Cosmic Ray; the tests of a mutant's room must see it. SEED=… draws others, and
# ROOMS="core decisions" draws in these rooms only. mutants.jsonl has the results; a call resumes.
N ?= 40
mutants: .venv/dev .venv/mutants
	.venv/mutants/bin/python -m tests.mutants --n $(N) $(if $(SEED),--seed $(SEED)) $(if $(ROOMS),--rooms $(ROOMS))
.venv/mutants:
	$(PYTHON) -m venv $@
	$@/bin/pip install --quiet --disable-pip-version-check cosmic-ray

bench: .venv/dev
	$(BIN)/python -m tests.benchmarks.one_kilohertz

# This host's timing against the limit: ARGS="--rates 1000 --seconds 60"
timing: .venv/dev
	$(BIN)/python -m tests.benchmarks.host_timing $(ARGS)

# SEEDS=1000 schedules of drawn faults; SEED=… runs one again and writes its story. With
# STALLS=tolerated or suffered the emulator is also stalled, and its clock stops or does not.
# With CORE=1 the device's firmware is the C core; with UNO=1 the Uno's binary in simavr is the device,
# judged at its pin: a second or two a schedule. UNO=tclab is the image of a shield.
SEEDS ?= $(if $(UNO),200,1000)
simulate: .venv/dev $(if $(UNO),fil)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.simulator $(if $(SEED),--seed $(SEED),--seeds $(SEEDS)) $(if $(STALLS),--stalls $(STALLS)) $(if $(CORE),--core) $(if $(UNO),--uno $(patsubst 1,uno,$(UNO)))

# 10^8 bytes of frames, 10^6 commands, 10^6 files read, 10^5 recovered, 64 KiB cut at every byte, 1 MiB at 10^4 places: an hour.
fuzz: .venv/dev
	$(BIN)/python -m tests.fuzz

# The Uno's images, of Debian's gcc-avr and avr-libc. The same sources give the same bytes.
firmware:
	$(MAKE) -C firmware_protocol/firmware/boards/uno all

# The simulator of that binary, with Debian's libsimavr-dev. It is GPL, and in no wheel.
simavr fil:
	$(MAKE) -C firmware_protocol/simavr

# The site, in docs/_build/html: its first page is docs/index.html. A warning is an error, and so is
# a dead link inside the site, a public name without an example, or an option without help.
docs: .venv/dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/sphinx-build -q -E -W --keep-going -d docs/_build/doctrees -b html -c docs . docs/_build/html
	PYTHONPATH=docs $(BIN)/python -m site_parts.counts docs/_build/html

# Lock the exact versions and their hashes, for all systems, here and in CI: after each change of
# pyproject.toml's dependencies. UPGRADE=1 takes the newest versions.
LOCKED = $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
  --no-header --no-annotate --no-strip-extras $(if $(UPGRADE),--upgrade)
lock: $(BIN)/pip
	$(BIN)/pip install --quiet uv
	$(LOCKED) pyproject.toml -o requirements.lock
	$(LOCKED) pyproject.toml --extra dev --constraint requirements.lock -o tests/requirements.lock
	sed -n 's/^requires = \["\(.*\)"\]$$/\1/p' pyproject.toml | $(LOCKED) - --constraint tests/requirements.lock -o requirements.build.lock

# The clients' tests with the oldest versions that pyproject.toml allows. Deprecations among these
# versions are not armrig's faults, so the warnings are ignored.
lowest: .venv/dev
	$(BIN)/uv venv --quiet --clear --python $(PYTHON) .venv/lowest
	$(BIN)/uv pip install --quiet --python .venv/lowest/bin/python pytest hypothesis websockets hatchling
	$(BIN)/uv pip install --quiet --python .venv/lowest/bin/python --resolution lowest-direct --editable '.[pandas,xarray,parquet,mcap,dask,pki,share]'
	.venv/lowest/bin/pytest -q -p no:cacheprovider -W ignore::DeprecationWarning tests/clients tests/core tests/protocol --deselect tests/clients/cli/test_laptop.py

# Known vulnerabilities of the installed packages, by a query to pypi.org. If the index knows none of
# the packages, nothing was audited, and the target fails; with MAY_SKIP=1 it only prints this.
audit: .venv/dev
	$(BIN)/python -m tests.audit requirements.lock requirements.build.lock $(if $(MAY_SKIP),|| [ $$? = 3 ])

# The release of a tagged commit, in dist/: notes, sources, wheel, SBOM, docs and hashes. `make
# reproduce`, as root, makes the release of HEAD on two empty Debians, and compares the hashes.
release: .venv/dev
	.ci/release
reproduce: .venv/dev
	$(BIN)/python -m tests.reproduce

format: .venv/dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/python -m armrig_protocol.generate
	$(BIN)/python -m armrig_daemon.configuration_reference

clean:
	rm -rf .venv demo dist

# What a user needs, in the locked versions; repeated when they change. Without the isolation of its
# build, pip downloads no package without a hash.
.venv/run: pyproject.toml requirements.lock requirements.build.lock | $(BIN)/pip
	$(PIP) --require-hashes -r requirements.lock -r requirements.build.lock
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

# What a developer needs in addition.
.venv/dev: pyproject.toml tests/requirements.lock | $(BIN)/pip
	@command -v cc >/dev/null || { echo "no C compiler (cc), which the tests need; on Debian: apt install gcc libc6-dev" >&2; exit 1; }
	$(PIP) --require-hashes -r tests/requirements.lock
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@ .venv/run

# `PYTHON=…` on the command line and a `.venv` of another version: nothing would use that Python.
ifeq ($(origin PYTHON),command line)
.venv/run .venv/dev: | is-of-this-python
endif
.PHONY: is-of-this-python
is-of-this-python: | $(BIN)/pip
	@[ "$$($(PYTHON) -V)" = "$$($(BIN)/python -V)" ] || { echo "PYTHON=$(PYTHON) is $$($(PYTHON) -V), but .venv has $$($(BIN)/python -V); remove .venv (make clean), or leave PYTHON out" >&2; exit 1; }

# pip names a wrong Python only by a package that it does not find.
$(BIN)/pip:
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" 2>/dev/null || { echo "armrig needs Python 3.11 or later; $(PYTHON) is $$($(PYTHON) -V 2>/dev/null || echo missing); install it, or $(OTHER_PYTHON)" >&2; exit 1; }
	@$(PYTHON) -c "import ensurepip, venv" 2>/dev/null || { echo "$(PYTHON) has no venv; on Debian: apt install python3-venv; or $(OTHER_PYTHON)" >&2; exit 1; }
	$(PYTHON) -m venv .venv
