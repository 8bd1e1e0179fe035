# Everything a newcomer needs: `make demo`, `make test`. A second run installs nothing.
MAKEFLAGS += --no-builtin-rules
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# the core and the tools of its tests; what needs more is skipped by name. `make test EXTRAS=dev$(MORE),biomech` skips nothing
EXTRAS ?= dev
MORE   := ,cluster,data,onnx,sim,teleop,viewer,ros
SUM    := $(shell (cat pyproject.toml packages/*/pyproject.toml constraints.txt tools/install.sh; echo $(EXTRAS)) | cksum | cut -d' ' -f1)
READY  := $(VENV)/.ready-$(SUM)
CORE   := $(VENV)/.core-$(SUM)

QUICK  := not slow and not realtime and not fuzz

# the parts that can be tested alone, `make test-files`: folders of tests, and the extras that they need besides `dev`
PARTS           := laws files estimation calibration body recorded live ros sim studio teleop
PART_laws       := laws derivatives oracles contracts golden
PART_files      := foundation core formats outputs
PART_estimation := detection fusion association tracking
PART_calibration := calibration health
PART_body       := kinematics evaluation
PART_recorded   := pipeline api cli truth edges
PART_live       := realtime sources
PART_ros        := ros
PART_sim        := simulation paper
PART_studio     := studio
PART_teleop     := teleoperation
EXTRA_ros       := ,ros
EXTRA_sim       := ,sim
EXTRA_teleop    := ,teleop

# what CI does not run (benches, tools, slow tests) is read for names and arguments that do not exist; all of `strict` is for what ships
UNREAD  := arg-type assignment call-overload comparison-overlap dict-item func-returns-value has-type import-not-found import-untyped \
	index list-item method-assign misc no-any-return no-untyped-call no-untyped-def operator return-value type-arg type-var \
	union-attr unreachable valid-type var-annotated
NAMES   := --explicit-package-bases $(UNREAD:%=--disable-error-code %)
SLOW     = $(shell grep -rl mark.slow tests)

# the slow tests that guard a promise of the README (docs/promises.md)
PROMISES := tests/api/test_gallery.py tests/cli/test_interruptions.py tests/paper/test_scenes.py

.PHONY: mutation calibration-faults help setup setup-core demo test test-realtime test-promises test-slow $(PARTS:%=test-%) fuzz check bench bench-live paper demo-clip pictures docs package clean

help:
	@echo "make demo       set up, then run the whole pipeline on the bundled clip"
	@echo "make test       set up, then run the tests; with EXTRAS=dev$(MORE),biomech those of every part"
	@echo "make test-PART  set up what it needs, then run the tests of one part: $(PARTS)"
	@echo "make test-realtime  what keeps pace with the clock: five minutes in which nothing else should run"
	@echo "make test-promises  the slow tests that guard a promise of the README: docs/promises.md"
	@echo "make test-slow  the minutes-long studies"
	@echo "make fuzz       some 4,000 damaged files for every reader and command; the table of docs/reliability.md"
	@echo "make check      lint, format, types"
	@echo "make bench      every figure of docs/benchmarks.md"
	@echo "make calibration-faults  constructed faults of calibrations, and what is answered to each"
	@echo "make mutation  which small changes of the code do no tests notice? docs/mutation.md"
	@echo "make bench-live the figures of live tracking"
	@echo "make paper      the paper's experiments: pages in out/paper, docs/accuracy.md"
	@echo "make demo-clip  render the bundled clip again with the simulator"
	@echo "make pictures   draw the pictures of the docs again"
	@echo "make docs       build the documentation site in out/site; a warning is an error"
	@echo "make package    build, check and try what would be published; nothing is uploaded; the table of docs/installing.md"

setup: $(READY)

$(READY): pyproject.toml $(wildcard packages/*/pyproject.toml) constraints.txt tools/install.sh
	PYTHON=$(PYTHON) bash tools/install.sh $(VENV) $(EXTRAS)
	@touch $@

# other extras than those of the tests
with-%:
	@$(MAKE) --no-print-directory setup EXTRAS=$*

# what `track`, `live` and `report` need, and nothing else: no MuJoCo, linters
setup-core: $(CORE)

$(CORE): pyproject.toml constraints.txt tools/install.sh
	PYTHON=$(PYTHON) bash tools/install.sh $(VENV) ""
	@rm -f $(VENV)/.core-* && touch $@

demo: setup-core
	$(BIN)/posefuse demo --out out/demo --force

test: setup
	$(BIN)/python -m pytest -rs -n auto --maxprocesses 4 --dist loadfile -m "$(QUICK)"

test-realtime: setup
	$(BIN)/python -m pytest -rs -m "realtime and not slow and not fuzz"

.SECONDEXPANSION:
$(PARTS:%=test-%): test-%: with-dev$$(EXTRA_$$*)
	$(BIN)/python -m pytest -rs -n auto --maxprocesses 4 --dist loadfile -m "$(QUICK)" $(PART_$*:%=tests/%)

# one package built: `make test-ros wheel-ros VENV=out/ros` installs, tests and builds it alone
wheel-%:
	$(BIN)/python -m pip wheel --no-deps --wheel-dir dist packages/posefuse-$*

test-promises: setup
	$(BIN)/python -m pytest -rs -m "slow and not realtime" $(PROMISES)

test-slow: setup
	$(BIN)/python -m pytest -m slow

fuzz: with-dev$(MORE)
	$(BIN)/python tests/fuzz/drive.py --write docs/reliability.md

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	MYPYPATH=bench:tools $(BIN)/mypy $(NAMES) bench tools/*.py
	MYPYPATH=tests/support $(BIN)/mypy $(NAMES) paper $(SLOW)

bench: with-dev$(MORE)
	for name in pipeline real_footage detect fuse render kinematics calibrate wire; do \
		$(BIN)/python bench/$$name.py --write docs/benchmarks.md || exit; done

calibration-faults: with-dev$(MORE)
	nice $(BIN)/python bench/calibration_faults.py --write docs/calibration_faults.md

mutation: with-dev$(MORE),mutation
	nice $(BIN)/python bench/mutation.py --count 7 --seed 20261128 --write docs/mutation.md

bench-live: with-dev$(MORE)
	$(BIN)/python bench/live.py --write docs/benchmarks.md

paper: with-dev$(MORE)
	$(BIN)/python -m paper all --out out/paper
	cp out/paper/accuracy.md docs/accuracy.md

demo-clip: with-dev$(MORE)
	$(BIN)/posefuse simulate examples/scenes/demo.yaml --out examples/demo --force
	$(BIN)/python tools/wheel_clip.py

pictures: demo with-dev$(MORE),docs
	cp out/demo/overview.png docs/images/overview.png
	$(BIN)/python docs/make_simulation_pictures.py
	$(BIN)/python -m tools.docs_site.pictures

docs: with-dev,docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

package: with-dev,publish
	$(BIN)/python tools/package.py --write docs/installing.md

clean:
	rm -rf out build dist .pytest_cache .mypy_cache .ruff_cache
