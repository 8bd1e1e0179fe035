# Everything a newcomer needs: `make demo`, `make test`. A second run installs nothing.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
EXTRAS ?= dev,docs,publish,sim,teleop,viewer,ros
SUM    := $(shell (cat pyproject.toml constraints.txt tools/install.sh; echo $(EXTRAS)) | cksum | cut -d' ' -f1)
READY  := $(VENV)/.ready-$(SUM)
CORE   := $(VENV)/.core-$(SUM)

.PHONY: mutation calibration-faults help setup setup-core demo test test-slow fuzz reliability check bench bench-live paper demo-clip pictures docs package clean

help:
	@echo "make demo       set up, then run the whole pipeline on the bundled clip"
	@echo "make test       set up, then run the tests"
	@echo "make test-slow  the minutes-long studies"
	@echo "make fuzz       some 4,000 damaged files for every reader and command; the table of docs/reliability.md"
	@echo "make reliability  the fuzz stage and every other attempt to lose work; all tables of docs/reliability.md"
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

$(READY): pyproject.toml constraints.txt tools/install.sh
	PYTHON=$(PYTHON) bash tools/install.sh $(VENV) $(EXTRAS)
	@rm -f $(VENV)/.ready-* && touch $@

# what `track`, `live` and `report` need, and nothing else: no torch, MuJoCo, linters
setup-core: $(CORE)

$(CORE): pyproject.toml constraints.txt tools/install.sh
	PYTHON=$(PYTHON) bash tools/install.sh $(VENV) ""
	@rm -f $(VENV)/.core-* && touch $@

demo: setup-core
	$(BIN)/posefuse demo --out out/demo --force

test: setup
	@failed=0; \
	$(BIN)/python -m pytest -rs -n auto --maxprocesses 4 --dist loadfile -m "not slow and not realtime and not fuzz" || failed=1; \
	$(BIN)/python -m pytest -rs -m "realtime and not slow and not fuzz" || failed=1; \
	exit $$failed

test-slow: setup
	$(BIN)/python -m pytest -m slow

fuzz: setup
	$(BIN)/python tests/fuzz/drive.py --write docs/reliability.md

reliability: fuzz
	$(BIN)/python tests/fuzz/attempts.py --write docs/reliability.md

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: setup
	$(BIN)/python bench/run.py

calibration-faults: setup
	nice $(BIN)/python bench/calibration_faults.py --page docs/calibration_faults.md

mutation: EXTRAS := $(EXTRAS),mutation
mutation: setup
	nice $(BIN)/python bench/mutation.py --count 20 --minutes 60 --survivors --page docs/mutation.md

bench-live: setup
	$(BIN)/python bench/run.py live live_tracking live_faults

paper: setup
	$(BIN)/python -m paper all --out out/paper
	cp out/paper/accuracy.md docs/accuracy.md

demo-clip: setup
	$(BIN)/posefuse simulate examples/scenes/demo.yaml --out examples/demo --force
	$(BIN)/python tools/wheel_clip.py

pictures: demo
	cp out/demo/overview.png docs/images/overview.png
	$(BIN)/python docs/make_simulation_pictures.py
	$(BIN)/python -m tools.docs_site.pictures

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

package: setup
	$(BIN)/python tools/package.py --write docs/installing.md

clean:
	rm -rf out build dist .pytest_cache .mypy_cache .ruff_cache
