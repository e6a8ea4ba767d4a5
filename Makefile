# hilsat: `make run` flies the published scenario, `make test` runs the tests. Everything lives in .venv; no root needed.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
SCENARIO ?= zhang2018
# Most tests start Python again: without byte code kept, each of them would compile everything once more.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run setup test test-slow test-all test-vcan test-foxglove test-browser test-compiled test-wheel lint coverage coverage-gate compiled plain clean

run: $(STAMP)
	$(BIN)/hilsat run $(SCENARIO)

setup: $(STAMP)

$(STAMP): pyproject.toml
	@case "$$(uname -s)" in Linux) ;; *) echo "hilsat needs Linux; on Windows use WSL, on macOS a Linux VM" >&2; exit 2;; esac
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: sudo apt-get install python3 python3-venv" >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$(PYTHON) is older than 3.11: sudo apt-get install python3.11 python3.11-venv, then make PYTHON=python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "the venv module is missing: sudo apt-get install $$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "pip>=25.1"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e . --group dev
	@touch $(STAMP)

test: $(STAMP)
	$(BIN)/python -m pytest -n auto -m "not slow and not vcan and not vcan_host and not compiled and not browser"

test-slow: $(STAMP)
	HILSAT_THOROUGH=1 $(BIN)/python -m pytest -n auto -m "(slow or hypothesis) and not vcan and not vcan_host and not compiled and not browser"

test-all: test test-slow test-vcan test-foxglove test-browser test-compiled test-wheel

# The same tests against the compiled build, and the same bytes from both for every scenario, or those that DIGESTS picks
# (as pytest's -k does).
DIGESTS ?=
test-compiled: compiled
	HILSAT_BUILD=compiled $(BIN)/python -m pytest -n auto -m "not slow and not vcan and not vcan_host and not compiled and not browser"
	$(BIN)/python -m pytest -n auto -m compiled -k "$(DIGESTS)"

# A compiled wheel, installed alone, flies.
test-wheel: $(STAMP)
	rm -rf build/wheel build/installed
	HILSAT_COMPILE=1 $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w build/wheel .
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target build/installed build/wheel/*.whl
	cd build/installed && PYTHONPATH=. HILSAT_BUILD=compiled $(CURDIR)/$(BIN)/python -P -m tools.cli --version
	cd build/installed && PYTHONPATH=. HILSAT_BUILD=compiled $(CURDIR)/$(BIN)/python -P -m tools.cli run zhang2018 \
	  --clock lockstep --no-plot -q --out run

# Real AF_CAN: natively where the kernel has CAN, else in a user-mode Linux guest; fails where neither works.
test-vcan: $(STAMP)
	@command -v candump >/dev/null || $(BIN)/python -P -c 'from tools.vcan.packages import unpack; unpack("can-utils")'
	$(BIN)/hilsat vcan exec --can vcan0,vcan1 --rw . -- $(BIN)/python -m pytest -p no:cacheprovider -m vcan
	$(BIN)/python -m pytest -m vcan_host

# A log as Foxglove's own libraries see it: every index, schema and message.
test-foxglove: $(STAMP)
	@command -v npm >/dev/null || { echo "npm is missing: sudo apt-get install nodejs npm" >&2; exit 2; }
	@mkdir -p $(VENV)/foxglove && cp tests/foxglove/* $(VENV)/foxglove && rm -rf $(VENV)/foxglove/log
	npm install --prefix $(VENV)/foxglove --silent --no-audit --no-fund --no-package-lock --ignore-scripts
	$(BIN)/hilsat run zhang2018 --no-plot -q --out $(VENV)/foxglove/log >/dev/null
	node $(VENV)/foxglove/read_log.mjs $(VENV)/foxglove/log/run.mcap

# Pages in a real browser: the machine's own Chromium, else one that playwright brings.
test-browser: $(STAMP)
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null \
	  || $(BIN)/playwright install chromium \
	  || { echo "there is no browser and none can be fetched: sudo apt-get install chromium" >&2; exit 2; }
	$(BIN)/python -m pytest -q -m browser

lint: $(STAMP)
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

# Lines are counted in sources: compiled modules have none.
coverage: $(STAMP)
	HILSAT_BUILD=plain $(BIN)/python -m pytest -n auto -m "not slow and not vcan and not vcan_host and not compiled and not browser" --cov --cov-report=term --cov-report=html

# What must never fail is covered whole: every line and branch of executive, codec and safe mode. `make test-slow` tries more
# examples of the same tests.
coverage-gate: $(STAMP)
	HILSAT_BUILD=plain $(BIN)/python -m pytest -q -n auto tests/unit/test_executive.py tests/unit/test_modes.py tests/unit/test_e2e.py \
	  tests/property/test_codec.py tests/property/test_usual_batch.py tests/property/test_cycle_fuzz.py \
	  --cov=fsw.executive --cov=fsw.schedule --cov=fsw.modes --cov=bus.icd.codec --cov=bus.icd.e2e \
	  --cov-branch --cov-report=term-missing --cov-fail-under=100

# The modules of pyproject.toml's list, compiled beside their sources: docs/compiling.md.
compiled: $(STAMP)
	@$(BIN)/python -P -m tools.compiled.build

# Manifest last: what an interruption leaves is noticed.
plain:
	find bus fsw hilsat plant_server tools -name '*.so' -delete
	rm -f bus/compiled.json

clean: plain
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis htmlcov .coverage*
