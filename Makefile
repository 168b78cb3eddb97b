# Targets create the environment in .venv when it is missing or older than what it is made from.

# Python 3.11 is the last for which pybullet has wheels; with another the compiled twin flies.
PYTHON ?= $(shell python3.11 -c 'import sys; print(sys.executable)' 2>/dev/null || echo python3)
VENV := .venv
BIN := $(VENV)/bin
# On a terminal pip shows its progress bars, elsewhere only what goes wrong.
INSTALL := $(BIN)/python -m pip install $(shell test -t 2 || echo --quiet) -c constraints.txt

# One thread: numbers do not depend on the machine's cores, and small arrays are faster.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

.DEFAULT_GOAL := help
# Libraries that work with ours; what stands in one line can be installed together.
COMPAT := $(VENV)-compat
DOCS_VENV := $(VENV)-docs
PEERS_torchrl := torchrl benchmarl skrl
PEERS_rllib := 'ray[rllib]' torch
PEERS_jax := jax 'crazyflow>=0.4'
PEERS_wrappers := agilerl 'minari[hdf5]' supersuit
TESTS_torchrl := test_torchrl.py test_benchmarl.py test_skrl.py test_docs.py test_examples.py
TESTS_rllib := test_rllib.py test_docs.py
TESTS_jax := test_jax.py
TESTS_wrappers := test_agilerl.py test_docs.py test_minari.py test_supersuit.py

.PHONY: help demo test test-all test-compat coverage matrix lint format bench \
	bench-against docs tables dist films papers clean

help:
	@echo 'make demo      two drones swap places through each other'"'"'s downwash; results in demo/'
	@echo 'make test      the tests, without those marked slow'
	@echo 'make test-all  every test, test-compat among them'
	@echo 'make test-compat  tests with other libraries (TorchRL, RLlib, JAX, SuperSuit ...), in environments of their own'
	@echo 'make coverage  which lines the tests run, kernels interpreted too; a quarter of an hour'
	@echo 'make matrix    the wheel, installed as strangers would: oldest, newest, Python 3.11 to 3.14'
	@echo 'make lint      ruff, mypy and import-linter'
	@echo 'make format    let ruff mend what it can'
	@echo 'make bench     speed, and peers beside it where they are installed'
	@echo 'make bench-against REF=...  speed of this tree against that commit, measured in turn'
	@echo 'make docs      this documentation as a site, in build/docs'
	@echo 'make dist      the wheel, the source archive and the documentation as a zip, in dist'
	@echo 'make tables    the tables in the pages of the docs'
	@echo 'make films     the films of the docs, in docs/films'
	@echo 'make papers    the quick figures and tables of the papers, and the table of docs/papers.md'
	@echo 'make clean     remove everything that these made'

$(VENV)/.python:
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.base: $(VENV)/.python pyproject.toml constraints.txt
	@echo 'Installing swarm-envs in $(VENV), once; this takes a minute or two ...'
	$(INSTALL) -e '.[film]'
	@touch $@

$(VENV)/.dev: $(VENV)/.python pyproject.toml constraints.txt
	@echo 'Installing swarm-envs and its development tools in $(VENV), once; a few minutes ...'
	$(INSTALL) -e '.[dev]'
	@touch $(VENV)/.base $@

demo: $(VENV)/.base
	$(BIN)/swarm-envs demo --out demo

# As many processes as there are cores; each test file stays in one.
test: $(VENV)/.dev
	$(BIN)/python -m pytest -n auto --dist loadfile

test-all: $(VENV)/.dev test-compat
	$(BIN)/python -m pytest -n auto --dist loadfile -m 'slow or not slow'

test-compat: test-compat-torchrl test-compat-rllib test-compat-jax test-compat-wrappers

test-compat-%: $(COMPAT)/%/.installed
	$(COMPAT)/$*/bin/python -m pytest -m slow $(addprefix tests/compat/,$(TESTS_$*))

.PRECIOUS: $(COMPAT)/%/.installed
$(COMPAT)/%/.installed: pyproject.toml constraints.txt
	@echo "Installing $(PEERS_$*) in $(COMPAT)/$*, once; a few minutes, and 2 GB ..."
	$(PYTHON) -m venv $(COMPAT)/$*
	$(subst $(BIN),$(COMPAT)/$*/bin,$(INSTALL)) -e . pytest hypothesis $(PEERS_$*)
	@touch $@

# Tests small enough for kernels that are interpreted, which is how their lines are seen.
INTERPRETED := $(addprefix tests/test_,motors.py neighbors.py noise.py tables.py) \
	tests/test_safety.py::test_the_nearest_point_is_that_of_a_quadratic_program \
	tests/test_safety.py::test_what_cannot_be_satisfied_is_broken_the_least \
	tests/test_safety.py::test_the_barrier_is_the_distance_to_velocities_that_collide \
	tests/interactions/test_composed.py::test_forces_are_those_of_the_formula \
	$(addprefix tests/physics/,test_contact.py test_rigid_body.py) \
	$(addprefix tests/control/,test_mixer.py test_tracking.py) \
	$(addprefix tests/tasks/,test_motion.py test_rewards.py) \
	tests/baselines/rth3d/test_flight.py::test_planes_stand_where_two_robots_are_nearest \
	tests/baselines/rth3d/test_validation.py \
	$(addprefix tests/baselines/neural_swarm/planner/,test_steering.py) \
	$(addprefix tests/baselines/mlr_dmpc/,test_trajectory.py test_corridors.py test_reach.py)

coverage: $(VENV)/.dev
	rm -rf build/coverage && mkdir -p build/coverage
	$(BIN)/python -m coverage run -m pytest -n auto --dist loadfile
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run -m pytest -n auto --dist loadfile $(INTERPRETED)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

# `make matrix MATRIX='--rows oldest 3.13 --python 3.13=/path/to/python'`; a few minutes a row.
matrix: $(VENV)/.dev
	$(BIN)/python -m tests.packaging.matrix $(MATRIX)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy swarm_envs tests benchmarks
	$(BIN)/lint-imports --no-cache

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# `make bench PEERS=/path/to/python`: an environment with gym-pybullet-drones and crazyflow.
PEERS ?= $(BIN)/python
bench: $(VENV)/.dev
	$(BIN)/python -m benchmarks.forces
	$(BIN)/python -m benchmarks.throughput --peers $(PEERS)
	$(BIN)/python -m benchmarks.batched --peers $(PEERS)
	$(BIN)/python -m benchmarks.live

# `make bench-against REF=d9123f6`; the other tree and cached kernels are kept in build/against.
REF ?= HEAD
bench-against: $(VENV)/.dev
	$(BIN)/python -m benchmarks.against --ref $(REF) \
		$(if $(filter-out $(BIN)/python,$(PEERS)),--peers $(PEERS)) $(AGAINST)

# In an environment without torch, and any warning is an error.
$(DOCS_VENV)/.installed: pyproject.toml constraints.txt
	@echo 'Installing what builds the documentation in $(DOCS_VENV), once; a minute, and 1 GB ...'
	$(PYTHON) -m venv $(DOCS_VENV)
	$(subst $(BIN),$(DOCS_VENV)/bin,$(INSTALL)) -e '.[docs]'
	@touch $@

# From nothing: Sphinx does not see that the code from which pages are made has changed.
docs: $(DOCS_VENV)/.installed
	rm -rf build/docs
	$(DOCS_VENV)/bin/python -m sphinx -b html -W --keep-going docs build/docs
	@echo 'open build/docs/index.html'

# A test checks that they are up to date.
tables: $(VENV)/.dev
	$(BIN)/python -m docs.tables.pages

# The wheel, the source archive, and the documentation as one zip, in dist/.
dist: $(VENV)/.dev docs
	$(BIN)/python -m build
	$(BIN)/python -c "import shutil; from swarm_envs import __version__ as v; \
		shutil.make_archive(f'dist/swarm_envs-{v}-docs', 'zip', 'build/docs')"

# Films of the docs, a minute each: `make films FILMS='swap gates'` for some.
films: $(VENV)/.dev
	$(BIN)/python docs/films.py $(FILMS)

# Ten minutes of CPU time; docs/papers.md says which commands take longer.
PAPERS := build/papers
NS2 := $(BIN)/python -m examples.papers.neural_swarm2
DMPC := $(BIN)/python -m examples.papers.dmpc_swarm
papers: $(VENV)/.dev
	$(NS2) table-1 --out $(PAPERS)/neural_swarm2
	$(NS2) figure-5 --out $(PAPERS)/neural_swarm2
	$(NS2) figure-6 --engine batch --out $(PAPERS)/neural_swarm2
	$(NS2) as-flown --out $(PAPERS)/neural_swarm2
	for figure in 1 8 9; do \
		$(NS2) figure-$$figure --world hall --truth learned --episodes 20 --engine batch \
			--out $(PAPERS)/neural_swarm2 || exit 1; done
	for figure in 3a 3b 3c 4; do $(DMPC) figure-$$figure --out $(PAPERS)/dmpc_swarm || exit 1; done
	$(DMPC) hall --out $(PAPERS)/dmpc_swarm
	$(BIN)/python -m examples.papers.rth3d figure-11 --out $(PAPERS)/rth3d
	$(BIN)/python -m examples.papers $(PAPERS)

clean:
	rm -rf $(VENV) $(COMPAT) $(DOCS_VENV) build dist demo *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find swarm_envs agents baselines training tests benchmarks -name __pycache__ -prune -exec rm -rf {} +
