# Targets of VisualRHP. Needs Python 3.11 or newer and make; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
PEERS := $(VENV)/peers
PORT ?= 5000

export PATH := $(CURDIR)/$(VENV)/bin:$(PATH)
# No tool of the project sends usage statistics.
export DVC_NO_ANALYTICS := true
export MLFLOW_DISABLE_TELEMETRY := true
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# A stamp is written when an installation is complete; the next make resumes an unfinished one.
INSTALLED := $(VENV)/.installed
INSTALLED_FOR_TEST := $(VENV)/.installed-for-test
INSTALLED_FOR_ROBOT := $(VENV)/.installed-for-robot

.DEFAULT_GOAL := help
.PHONY: help venv install demo robot repro test lint format ui bench bench-peers torture clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1@\2/p' $(MAKEFILE_LIST) | awk -F@ '{ printf "%-18s %s\n", $$1, $$2 }'

venv: $(VENV)/.created ## create the virtual environment

install: $(INSTALLED) ## install the pinned versions into the virtual environment

demo: $(INSTALLED) ## play three scenes with the released networks (videos in outputs/play)
	python -m pipelines.play heuristics=pretrained scene.num_objects=6 index=2 live=false
	python -m pipelines.play heuristics=pretrained scene.num_objects=5 index=3 action_space=discrete live=false
	python -m pipelines.play heuristics=pretrained scene_file=examples/scenes/push.yaml live=false
	@echo "The videos, to be opened in a browser: $(CURDIR)/outputs/play"

robot: $(INSTALLED_FOR_ROBOT) ## run an episode of a robot in a simulated cell (video in outputs/execute)
	python -m pipelines.execute cell.num_objects=5 index=1
	@echo "The video, to be opened in a browser: $(CURDIR)/outputs/execute"

repro: $(INSTALLED) ## run the whole pipeline: demonstrations, learning, evaluation, report
	@$(DVC_WITH_OR_WITHOUT_GIT)
	dvc repro

test: $(INSTALLED_FOR_TEST) ## lint, check types and run the tests
	ruff check .
	ruff format --check .
	pyright
	pytest -n auto --dist loadfile --no-loadscope-reorder tests

lint: $(INSTALLED_FOR_TEST) ## lint and check types only
	ruff check .
	ruff format --check .
	pyright

format: $(INSTALLED_FOR_TEST) ## format the code
	ruff format .
	ruff check --fix .

ui: $(INSTALLED) ## show the runs in MLflow, on http://127.0.0.1:5000 (PORT=...)
	@echo "The runs: http://127.0.0.1:$(PORT)/#/experiments/1/runs?workflowType=machine_learning"
	mlflow ui --backend-store-uri "sqlite:///$(CURDIR)/outputs/mlflow.db" --host 127.0.0.1 --port $(PORT)

bench: $(INSTALLED_FOR_TEST) ## run the benchmarks
	python -m tests.benchmarks

bench-peers: $(INSTALLED_FOR_TEST) $(PEERS)/gym-pusht/.installed $(PEERS)/kinder/.installed ## compare the speed with gym-pusht and KinDER
	python -m tests.benchmarks peers

torture: $(INSTALLED_FOR_TEST) ## kills, damaged files and hostile inputs in large numbers (an hour)
	python -m tests.torture

clean: ## delete the virtual environment and caches, but not outputs
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis *.egg-info

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "VisualRHP needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>&1 | head -n 1). Try: make $(MAKECMDGOALS) PYTHON=python3.11" >&2; \
	  exit 1; }
	@$(VENV)/bin/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@touch $@

$(INSTALLED): $(VENV)/.created pyproject.toml constraints.txt
	python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(INSTALLED_FOR_TEST): $(VENV)/.created pyproject.toml constraints.txt
	python -m pip install --quiet --constraint constraints.txt --editable ".[test]"
	@touch $(INSTALLED) $(INSTALLED_FOR_ROBOT) $@

$(INSTALLED_FOR_ROBOT): $(VENV)/.created pyproject.toml constraints.txt
	python -m pip install --quiet --constraint constraints.txt --editable ".[robot]"
	@touch $(INSTALLED) $@

# The compared environments pin different versions of pymunk.
$(PEERS)/%/.installed: tests/benchmarks/peers/%.txt | $(VENV)/.created
	python -m venv --clear $(@D)
	$(@D)/bin/python -m pip install --quiet --no-deps --requirement $<
	@touch $@

# DVC must be told when the project is not a git checkout (an unpacked archive).
define DVC_WITH_OR_WITHOUT_GIT
if [ -e .git ]; then \
  ! grep -qs no_scm .dvc/config.local || dvc config --quiet --local --unset core.no_scm; \
else \
  dvc config --quiet --local core.no_scm true; \
fi
endef
