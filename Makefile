# make demo   set everything up, run the main job and say where its report lies
# make test   set everything up and run the tests
# make docs   set everything up and build the documentation as a site
# make studio set everything up and build the page of the studio, with npm
#
# PYTHON=...        interpreter to build the environment with (3.11 or newer)
# PIP_FLAGS=...     given to pip install, such as another package index
# PYTEST_FLAGS=...  given to pytest

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)

.PHONY: demo test docs studio environment test-environment docs-environment opengl lint types clean

demo: environment opengl
	$(BIN)/luxloop run snowflake --out runs/snowflake
	@echo "The report lies in $(CURDIR)/runs/snowflake/report.png"

# One thread a worker: two workers whose OpenMP threads spin against each other are many times slower.
test: test-environment opengl
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses=4 --dist loadfile --no-loadscope-reorder $(PYTEST_FLAGS)

docs: docs-environment
	$(BIN)/python scripts/build_docs.py
	@echo "The documentation begins at $(CURDIR)/build/site/index.html"

studio: environment
	$(BIN)/python -c "from luxloop.loop.studio.page import page; print('The page is', page())"

lint: test-environment
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: test-environment
	$(BIN)/mypy

environment: $(VENV)/installed
test-environment: $(VENV)/installed-test
docs-environment: $(VENV)/installed-docs

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/pip
	$(BIN)/pip install $(PIP_FLAGS) -c constraints.txt -e .
	@touch $@

$(VENV)/installed-docs: pyproject.toml constraints.txt | $(BIN)/pip
	$(BIN)/pip install $(PIP_FLAGS) -c constraints.txt -e '.[docs]'
	@touch $@ $(VENV)/installed

$(VENV)/installed-test: pyproject.toml constraints.txt | $(BIN)/pip
	$(BIN)/pip install $(PIP_FLAGS) -c constraints.txt -e '.[test]'
	@touch $@ $(VENV)/installed

# Debian's python3 comes without what venv needs to install pip.
$(BIN)/pip:
	@test -n "$(PYTHON)" || { echo "luxloop needs Python 3.11 or newer, and none is on the PATH: give PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || scripts/apt_install.sh \
		$$($(PYTHON) -c 'import sys; print("python{}.{}-venv".format(*sys.version_info))')
	$(PYTHON) -m venv $(VENV)

opengl: | environment
	@$(BIN)/python -c 'from luxloop.world.rendering.rasterise import Rasteriser; Rasteriser()' 2>/dev/null \
		|| scripts/apt_install.sh libegl1 libgl1 libgl1-mesa-dri \
		|| echo "Going on without OpenGL: luxloop casts rays instead."

clean:
	rm -rf $(VENV) build *.egg-info loop/studio/page studio/node_modules
