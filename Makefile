# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
VEHICLE := .venv-vehicle
PEERS := .venv-peers
DOCS := .venv-docs
BROWSER := .venv-browser
PIP_FLAGS := -q --disable-pip-version-check
# Files of tests side by side: fixtures that a file shares are made once.
TOGETHER := -n 2 --dist loadfile

.PHONY: demo test test-vehicle test-thorough test-slow test-peers test-browser test-whole lint docs docs-links notebooks bench extremes install clean

demo: install
	$(BIN)/twin run scenes/yard

# What the vehicle's environment has run is not run again.
test: install lint test-vehicle
	$(BIN)/pytest $(TOGETHER) -m 'not slow and not peers and not browser and not whole and not thorough and not vehicle'

# The vehicle's part, as a package, where the simulator is not installed.
test-vehicle: $(VEHICLE)/.installed
	$(VEHICLE)/bin/pip install $(PIP_FLAGS) --no-deps --no-build-isolation --force-reinstall .
	cd tests/hardware && ../../$(VEHICLE)/bin/python -m pytest -c ../../pyproject.toml --rootdir ../.. -q $(TOGETHER) .

# What takes long for a test: many variants, whole scenes, statistics of a minute.
test-thorough: install
	$(BIN)/pytest $(TOGETHER) -m 'thorough and not slow'

# Long statistics.
test-slow: install
	$(BIN)/pytest -m slow --timeout 3600

# The same results as other people's libraries, in an environment of their own: several gigabytes.
test-peers: $(PEERS)/.installed
	$(PEERS)/bin/python -m pytest -m peers --timeout 1200 tests/hardware

# The report of the demo in Chromium: that of the system, or the one that UGV_BROWSER names.
test-browser: $(BROWSER)/.installed runs/yard-workable/report.html
	UGV_BROWSER="$${UGV_BROWSER:-$$(command -v chromium || command -v chromium-browser || command -v google-chrome)}" \
	    $(BROWSER)/bin/python -m pytest --noconftest -q -m browser tests/browser

runs/yard-workable/report.html:
	$(MAKE) demo

# Tutorials, how-to pages and notebooks as they stand; whole commands and studies.
test-whole: install
	$(BIN)/pytest -n 2 -m 'whole and not slow'

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# The documentation as a site in build/docs; nothing is fetched while it is built.
docs: $(DOCS)/.installed
	$(DOCS)/bin/python -m sphinx -W --keep-going -E -q -b html docs build/docs

# Links to elsewhere: asks the network.
docs-links: $(DOCS)/.installed
	$(DOCS)/bin/python -m sphinx -q -b linkcheck docs build/docs-links

# Stores with the notebooks what they show.
notebooks: install
	$(BIN)/jupyter execute --inplace --NotebookClient.record_timing=False notebooks/*.ipynb

# Every axis pushed until a result leaves its stated error; writes docs/extremes.md.
extremes: install
	$(BIN)/python -m tests.extremes

bench: install
	$(BIN)/python -m benchmarks

install: $(VENV)/.installed
	@setup/llvm.sh $(BIN)/python

$(VENV)/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "Python 3.11 or newer is needed; name one: make PYTHON=python3.11" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
	    { echo "venv is missing: sudo apt-get install python3-venv" >&2; exit 1; }
	$(BIN)/pip install $(PIP_FLAGS) -r requirements.lock
	$(BIN)/pip install $(PIP_FLAGS) --no-deps --no-build-isolation -e .
	@touch $@

$(VEHICLE)/.installed: requirements.lock pyproject.toml $(VENV)/.installed
	$(PYTHON) -m venv $(VEHICLE)
	$(VEHICLE)/bin/pip install $(PIP_FLAGS) -c requirements.lock pytest pytest-timeout pytest-xdist hypothesis hatchling
	$(VEHICLE)/bin/pip install $(PIP_FLAGS) --no-build-isolation -c requirements.lock .
	@touch $@

$(PEERS)/.installed: pyproject.toml
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install $(PIP_FLAGS) pytest pytest-timeout hypothesis -e .[accelerated,peers]
	@touch $@

$(BROWSER)/.installed: pyproject.toml
	$(PYTHON) -m venv $(BROWSER)
	$(BROWSER)/bin/pip install $(PIP_FLAGS) 'playwright>=1.50' 'pytest>=8.3' 'pytest-timeout>=2.3'
	@touch $@

# Sphinx by itself; the project and what it needs are those of $(VENV).
$(DOCS)/.installed: requirements-docs.lock $(VENV)/.installed
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/pip install $(PIP_FLAGS) -r requirements-docs.lock
	echo "import site; site.addsitedir('$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')')" \
	    > "$$($(DOCS)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/project.pth"
	@touch $@

clean:
	rm -rf $(VENV) $(VEHICLE) $(PEERS) $(DOCS) $(BROWSER) build runs bench.json
