VENV ?= .venv
RUN := $(VENV)/bin
RECORDINGS ?= ../shared/data

.PHONY: help setup test lint format demo bench docs constraints clean
.PHONY: leaderboard leaderboard-weather leaderboard-retrieval leaderboard-relocalization

help:            ## list the targets
	@grep -hE '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/' | expand -t 24

setup: $(VENV)/.ready ## virtual environment, pinned packages, the one system library

$(VENV)/.ready: tools/setup.sh constraints.txt pyproject.toml
	VENV=$(VENV) tools/setup.sh

test: setup      ## the test suite, quick ones first
	OMP_NUM_THREADS=1 $(RUN)/python -m pytest -q -n 2 --dist loadfile

lint: setup      ## style, types, import rules
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy
	$(RUN)/lint-imports

format: setup    ## format the code
	$(RUN)/ruff format .
	$(RUN)/ruff check --fix .

demo: setup      ## small dataset -> three trackers -> leaderboard
	$(RUN)/relocbench demo --out demo-output

bench: setup     ## every benchmark; each prints one JSON line last
	@for script in benchmarks/*.py; do echo "== $$script"; $(RUN)/python $$script || exit 1; done

docs: setup      ## check links and commands of docs/ and README.md, build the pages into site/
	$(RUN)/python tools/check_docs.py
	$(RUN)/mkdocs build --quiet --strict

leaderboard: setup ## make the published results again (RECORDINGS=folder of kitti_odometry/ and tum_rgbd/)
	tools/publish_leaderboard.sh $(RECORDINGS)

leaderboard-weather: setup ## make the published results across weathers again (renders and evaluates for hours)
	$(RUN)/python benchmarks/cross_weather.py --out leaderboard/weather

leaderboard-retrieval: setup ## make the published results of retrieval across views again (trains for hours; SAMPLE=folder of real pairs)
	tools/publish_retrieval.sh $(or $(SCRATCH),retrieval-scratch) $(SAMPLE)

leaderboard-relocalization: setup ## make the published results of both halves in a row again
	$(RUN)/python benchmarks/relocalization.py --out leaderboard/relocalization

constraints: setup ## pin the newest versions that fit
	$(RUN)/uv pip compile -q pyproject.toml --extra dev --extra cluster --extra registration --upgrade --generate-hashes \
	  --no-annotate --no-header --python-version 3.11 -o constraints.txt

clean:           ## remove what was generated
	rm -rf build dist site demo-output .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
