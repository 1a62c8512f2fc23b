VENV ?= .venv
SHELL := bash
RUN := $(VENV)/bin
RECORDINGS ?= ../shared/data

.PHONY: help setup kernels browser test test-rest test-all test-busy test-processors kills fuzz lint format demo bench prove docs light constraints image clean
.PHONY: leaderboard recompute leaderboard-edition leaderboard-retrieval leaderboard-relocalization

PIN := $(RUN)/uv pip compile -q pyproject.toml --extra dev --extra bags --extra cluster --extra registration --extra learned \
  --extra pretrained --extra fast --extra tensorboard --extra viewer --extra clouds --python-version 3.11 --custom-compile-command "make constraints"

help:            ## list the targets
	@grep -hE '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/' | expand -t 24

setup: $(VENV)/.ready ## virtual environment, pinned packages, system libraries

$(VENV)/.ready: tools/setup.sh tools/hashes.txt pyproject.toml relocbench/version.py
	VENV=$(VENV) tools/setup.sh

kernels: setup   ## compile what the demo and the tests need, where it is not there yet
	@OMP_NUM_THREADS=1 $(RUN)/python tools/compile_kernels.py

browser:         ## Chromium, which the tests of the pages in HTML open them in (they are skipped without one)
	tools/browser.sh

PYTEST := OMP_NUM_THREADS=1 $(RUN)/python -m pytest -q -n logical --dist worksteal --durations=20

test: kernels    ## the quick tests, of a second or so each, on all cores
	$(PYTEST) -m "not thorough"

test-rest: kernels ## the other tests, marked thorough: whatever takes longer
	$(PYTEST) -m thorough

test-all: kernels ## all tests: those of test and of test-rest
	$(PYTEST)

test-busy: kernels ## all tests with eight busy loops beside them
	tools/beside_busy_loops.sh 8 $(PYTEST)

test-processors: setup ## the tests as other processors would run them, a table of what failed (TESTS=files)
	VENV=$(VENV) tools/test_processors.sh $(TESTS)

kills: setup     ## kill each kind of job twenty times in the middle of its work and compare what it leaves
	$(RUN)/python benchmarks/truth/kills.py

fuzz: setup      ## damaged files for every reader (INPUTS=20000 SECONDS= SEED=0 JOBS=2 ONLY=part,of,names KEEP=folder)
	PYTHONPATH=.:tools:tests/support OMP_NUM_THREADS=1 $(RUN)/python -m fuzz --seed $(or $(SEED),0) --jobs $(or $(JOBS),2) \
	  --keep $(or $(KEEP),fuzz-failures) $(if $(SECONDS),--seconds $(SECONDS),--inputs $(or $(INPUTS),20000)) \
	  $(if $(ONLY),--only $(ONLY))

lint: setup      ## style, types, import rules
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy
	$(RUN)/lint-imports

format: setup    ## format the code
	$(RUN)/ruff format .
	$(RUN)/ruff check --fix .

demo: kernels    ## small dataset -> trackers -> what each finds in which condition, as README shows it
	set -o pipefail; $(RUN)/relocbench demo --out demo-output | $(RUN)/python tools/compare_demo.py

bench: setup     ## speed and memory; each benchmark prints one JSON line last
	@for script in benchmarks/speed/*.py; do echo "== $$script"; $(RUN)/python $$script || exit 1; done

prove: setup     ## the long proofs: ground truth by lidar, exactness of rendering, kills, other processors (hours)
	@for script in $$(grep -l __main__ benchmarks/lidar/*.py benchmarks/truth/*.py); do echo "== $$script"; $(RUN)/python $$script || exit 1; done

docs: setup      ## check links and commands of docs/ and README.md, build the pages into site/
	$(RUN)/python tools/check_docs.py
	NO_MKDOCS_2_WARNING=1 $(RUN)/mkdocs build --quiet --strict

leaderboard: setup ## make the published results again (RECORDINGS=folder of kitti_odometry/ and tum_rgbd/)
	tools/publish_leaderboard.sh $(RECORDINGS)

recompute: setup ## recompute the published pages and say which differ (RECORDINGS=folder; RENDER=yes, for hours)
	$(RUN)/python tools/recompute.py $(if $(wildcard $(RECORDINGS)),--recordings $(RECORDINGS)) $(if $(RENDER),--render)

leaderboard-edition: setup ## make the published results of an edition again, by tiers (renders and evaluates for hours; EDITION= SPLIT= SCRATCH=)
	$(RUN)/python benchmarks/publish/edition_page.py --edition $(or $(EDITION),2026.1) --split $(or $(SPLIT),validation) \
	  --scratch $(or $(SCRATCH),edition-scratch)

leaderboard-retrieval: setup ## make the published results of retrieval across views again (trains for hours; SAMPLE=folder of real pairs)
	tools/publish_retrieval.sh $(or $(SCRATCH),retrieval-scratch) $(SAMPLE)

leaderboard-relocalization: setup ## make the published results of both halves in a row again
	$(RUN)/python benchmarks/publish/relocalization.py --out leaderboard/relocalization

light: setup     ## the light installation: from the built wheel into an environment of its own (PYTHONS=python3.11 ...)
	VENV=$(VENV) tools/light_install.sh $(PYTHONS)

constraints: setup ## pin the newest versions that fit: constraints.txt to read, tools/hashes.txt to install
	$(PIN) --upgrade --annotation-style line -o constraints.txt
	$(PIN) --generate-hashes --no-annotate -c constraints.txt -o tools/hashes.txt

image: setup     ## the image of Dockerfile, or without Docker its steps in a folder of its own; runs the demo in it
	VENV=$(VENV) tools/image.sh

clean:           ## remove what was generated
	rm -rf build dist site demo-output .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache fuzz-failures
